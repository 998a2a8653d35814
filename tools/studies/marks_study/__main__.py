"""``python tools/studies/marks_study``: see study.py."""

import os
import sys
from pathlib import Path

for name, value in {"OPENBLAS_NUM_THREADS": "1", "DOO_TI_PINNED": "0", "TI_CPU_MAX_NUM_THREADS": "1"}.items():
    os.environ.setdefault(name, value)  # before NumPy and Taichi read them

if not __package__:
    sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

if __name__ == "__main__":
    from tools.studies.marks_study.study import main

    sys.exit(main())
