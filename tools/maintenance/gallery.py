"""Run the examples and keep a picture of each, for the gallery in docs/examples; it states which script has drawn it.

    python tools/maintenance/gallery.py [NUMBER…]
"""

import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image
from PIL.PngImagePlugin import PngInfo

EXAMPLES = Path(__file__).resolve().parents[2] / "docs" / "examples"
PICTURES = {"02": "runs/cable/landscape.png", "04": "thread.png", "07": "runs/ribbon/landscape.png",
            "10": "runs/cluster/landscape.png"}
"""What an example draws under another name than its own."""
WIDTH, COLOURS = 640, 128
DRAWN_BY = "sha256 of the script"


def digest(script: Path) -> str:
    return hashlib.sha256(script.read_bytes().replace(b"\r\n", b"\n")).hexdigest()


def main(numbers: list[str]) -> None:
    for script in sorted(EXAMPLES.glob("[0-9][0-9]_*.*")):
        if script.suffix not in (".py", ".sh") or numbers and script.name[:2] not in numbers:
            continue
        with tempfile.TemporaryDirectory() as folder:
            program = sys.executable if script.suffix == ".py" else shutil.which("bash")
            subprocess.run([program, str(script)], cwd=folder, check=True, env=os.environ | {"MPLBACKEND": "Agg"})
            picture = Image.open(Path(folder) / PICTURES.get(script.name[:2], f"{script.stem}.png")).convert("RGB")
        picture.thumbnail((WIDTH, WIDTH))
        about = PngInfo()
        about.add_text(DRAWN_BY, digest(script))
        picture.quantize(COLOURS).save(script.with_suffix(".png"), optimize=True, pnginfo=about)


if __name__ == "__main__":
    main(sys.argv[1:])
