"""What files of cameras leave open, whatever their format: unit, direction of poses, axes, kind of lens, orientation of images.

Which of them is right shows in what the cameras should see: with a wrong one, it is behind them or beside their images.
"""

from dataclasses import dataclass, replace

import numpy as np

from doo_ti.rod.physical_units import UNITS_IN_MM
from doo_ti.system.arguments import typed
from doo_ti.system.errors import InputError
from doo_ti.vision.cameras.camera import Camera

_TO_OPENGL = np.diag([1.0, -1.0, -1.0])
"""OpenGL's cameras have y up and z backwards."""
POSES = {
    "opencv": lambda turn, shift: (turn, shift),
    "opengl": lambda turn, shift: (_TO_OPENGL @ turn, _TO_OPENGL @ shift),
    "opencv-to-world": lambda turn, shift: (turn.T, -turn.T @ shift),
    "opengl-to-world": lambda turn, shift: (_TO_OPENGL @ turn.T, -_TO_OPENGL @ turn.T @ shift),
    "opencv-centre": lambda turn, shift: (turn, -turn @ shift),
}
"""What R and t of a file mean, and from them x_cam = R x_world + t with z forward: world to camera, camera to world, or R world
to camera and t the camera's centre."""
LENSES = ("opencv", "fisheye")


@typed
@dataclass(frozen=True)
class RigReading:
    """How a file of cameras is meant; None: as usual, and doubted where cameras then do not see what they should.

    unit    of lengths, one of ``doo_ti.rod.physical_units.UNITS_IN_MM``; None: mm
    poses   one of POSES; None: "opencv", x_cam = R x_world + t with z forward
    lens    "opencv", or "fisheye": of a stereo file, whose coefficients are k1, k2, k3, k4 of OpenCV's fisheye model
    turned  images are turned as their files' orientation tags say; None: as the rig says, else as the sensor has them
    size    width and height of the images, where the file does not state them

    Raises InputError for other words.
    """

    unit: str | None = None
    poses: str | None = None
    lens: str = "opencv"
    turned: bool | None = None
    size: tuple[int, int] | None = None

    def __post_init__(self) -> None:
        for name, known in (("unit", UNITS_IN_MM), ("poses", POSES), ("lens", LENSES)):
            value = getattr(self, name)
            if value is not None and value not in known:
                raise InputError("rig", name, f"{value!r} is unknown", f"give {', '.join(known)}")

    def applied(self, camera: Camera) -> Camera:
        """The camera of a file in our axes and mm."""
        turn, shift = POSES[self.poses or "opencv"](camera.rotation, camera.translation)
        changed = replace(camera, rotation=turn, translation=UNITS_IN_MM[self.unit or "mm"] * shift)
        return changed if self.turned is None else replace(changed, turned=self.turned)


def others(reading: RigReading) -> list[tuple[RigReading, str, str]]:
    """Other readings of the same file, what they assume, and the option for it: where neither unit nor poses were given."""
    if reading.unit or reading.poses:
        return []
    metres = [(RigReading(unit="m"), "its lengths are in m", "--rig-unit m")]
    kinds = [kind for kind in POSES if kind != "opencv"]
    poses = [(RigReading(poses=kind), f"its poses are {kind}", f"--rig-poses {kind}") for kind in kinds]
    both = [(RigReading("m", kind), f"its poses are {kind}, in m", f"--rig-poses {kind} --rig-unit m") for kind in kinds]
    return metres + poses + both
