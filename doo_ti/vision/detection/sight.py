"""The thread in an image file, by whatever there is of it: a mask, the image's own alpha channel, a colour, or grey levels."""

from dataclasses import dataclass, field, replace
from pathlib import Path

from doo_ti.system.errors import InputError
from doo_ti.vision.cameras.camera import Camera
from doo_ti.vision.detection.detect import detect
from doo_ti.vision.detection.images import read_image, read_mask
from doo_ti.vision.detection.line import Detection
from doo_ti.vision.detection.mask import detect_mask
from doo_ti.vision.detection.options import DetectionOptions


@dataclass(frozen=True)
class Sight:
    """How threads are sought in images.

    options  of the detection
    regions  by the name of a camera: the part of its images where the thread is, as ``options.region``
    masks    a folder with masks named as the images are, whatever their suffix; or a mask for each image, by its path; None:
             the image's alpha channel where it has one
    """

    options: DetectionOptions = DetectionOptions()
    regions: dict[str, tuple[int, ...]] = field(default_factory=dict)
    masks: Path | dict[Path, Path] | None = None

    def detected(self, path: Path, camera: Camera) -> Detection:
        """The thread in the image that ``camera`` took. Raises InputError for files that are missing or do not fit."""
        options = replace(self.options, region=self.regions.get(camera.name, self.options.region))
        mask = self._mask(path, camera)
        if mask is not None:
            return detect_mask(mask, options)
        return detect(read_image(path, camera, colour=options.colour is not None), options)

    def _mask(self, path: Path, camera: Camera):
        if self.masks is None:
            return read_mask(path, camera)
        if isinstance(self.masks, dict):
            found = self.masks[path]
        else:
            found = next(iter(sorted(self.masks.glob(f"{path.stem}.*"))), None)
            if found is None:
                raise InputError(self.masks, path.stem, "no mask of this name", "name masks as the images are")
        mask = read_mask(found, camera)
        return read_image(found, camera) if mask is None else mask
