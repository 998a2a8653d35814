"""``python -m doo_ti``, and the console command ``doo-ti``."""

import os
import sys
import warnings

from doo_ti.system.terminal import before_anything_is_begun, when_all_is_done, while_running


def main() -> int:
    """Import the command line and run it; returns the exit code."""
    interruptible = before_anything_is_begun()
    # On matrices this small NumPy's own threads only wait for each other, and take processors from the kernels.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if not sys.warnoptions:  # a refused input prints one line only; python -W shows warnings
        warnings.simplefilter("ignore")
    from doo_ti.commands.cli import main as command_line

    while_running(interruptible)
    code = command_line()
    when_all_is_done()
    return code


if __name__ == "__main__":
    sys.exit(main())
