"""``python -m doo_ti``, and the console command ``doo-ti``."""

import os
import sys
import warnings

from doo_ti.interruption import before_anything_is_begun, when_all_is_done, while_running


def main() -> int:
    """Import the command line and run it; returns the exit code."""
    interruptible = before_anything_is_begun()
    # NumPy's own threads only wait for each other over matrices as small as ours, and take processors from the kernels.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if not sys.warnoptions:  # what libraries warn of, beside the one line of a refused input; python -W shows it
        warnings.simplefilter("ignore")
    from doo_ti.cli import main as command_line

    while_running(interruptible)
    code = command_line()
    when_all_is_done()
    return code


if __name__ == "__main__":
    sys.exit(main())
