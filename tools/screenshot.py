"""Save what the viewer shows of a run as a PNG: ``python tools/screenshot.py RUN OUT.png``.

Needs no display but a Vulkan driver; on Debian: ``apt-get install mesa-vulkan-drivers libvulkan1``.
"""

import sys

from doo_ti.errors import InputError
from doo_ti.record import save_screenshot


def main(arguments: list[str]) -> int:
    if len(arguments) != 2:
        print("usage: python tools/screenshot.py RUN OUT.png", file=sys.stderr)
        return 2
    try:
        save_screenshot(*arguments)
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
