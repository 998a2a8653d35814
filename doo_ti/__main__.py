"""``python -m doo_ti``: the same as ``doo-ti``."""

import sys

from doo_ti.cli import main

if __name__ == "__main__":
    sys.exit(main())
