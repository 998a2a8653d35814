"""Rods that are knotted, as starts for relaxations and motions (docs/contact.md)."""

import numpy as np

from doo_ti.errors import InputError, require_number, require_whole
from doo_ti.frames import parallel_frames
