"""How threads are sought in images: by masks, their own alpha channels, a colour, or grey levels, and which of these shows the
thread under a clicked pixel best (§IV-A)."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from glob import escape
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from doo_ti.system.errors import InputError
from doo_ti.vision.cameras import Camera
from doo_ti.vision.detect import detect, detect_mask
from doo_ti.vision.detection import CLICK_PX, METHODS, NEAR_PX, POLARITIES, Detection, DetectionOptions
from doo_ti.vision.follow import follow
from doo_ti.vision.images import read_image, read_mask
from doo_ti.vision.ridge import POINTS_PER_PX, as_colour

COMPLETE = 0.9  # share of what has the thread's colour that lies on the followed path; from it on the path is the whole thread
BETTER = 0.01  # by which the score of another way to seek the thread must be larger
ON_IT = 0.5  # share of the followed path, of which less is detected where something else than the thread was
STRIP = 0.5  # width over that of the followed path; with less a strip of the thread is detected, its lit side or a glint


def mask_of(folder: Path, image: Path) -> Path:
    """The mask of an image in a ``folder``, or in its folder of the name that the image's has. Raises InputError."""
    for place in (folder / image.parent.name, folder):
        same = [file for file in sorted(place.glob(f"{escape(image.stem)}.*")) if file.stem == image.stem]
        if same:
            return same[0]
    raise InputError(folder, image.stem, "no mask of this name", "name masks as the images are")


@dataclass(frozen=True)
class Sight:
    """How threads are sought in images."""

    options: DetectionOptions = DetectionOptions()  # of the detection
    # by the name of a camera: the part of its images where the thread is, as ``options.region``
    regions: dict[str, tuple[int, ...]] = field(default_factory=dict)
    # a folder with masks named as the images are, or as their folders and they are, whatever their suffix; or the mask of each
    # camera's image, by the camera's name; None: the image's alpha channel where it has one
    masks: Path | dict[str, Path] | None = None
    # of each set of images, by the number of a camera, pixels of the thread: what it looks like there it does in all images of
    # the set, and of sets after it without any
    clicks: tuple[dict[int, tuple[float, float]], ...] | None = None
    by_colour: bool = False  # seek the thread by its colour at the pixels, where nothing else shows it better

    def of_set(self, row: int, paths: Sequence[Path], cameras: Sequence[Camera]) -> tuple["Sight", dict[int, Detection]]:
        """The same for the images ``paths`` of set ``row``: as options state it, or by colour; or, where the path that
        :func:`.follow` finds from the click is better seen so, by the polarity and the width of the thread there, by its
        colour, or by its colour in any light; and what it detects in the image that was clicked, by the number of its camera,
        where that is known. Raises InputError where no thread of a colour is at its pixel."""
        if self.clicks is None or not self.clicks[row]:
            return self, {}
        camera, pixel = min(self.clicks[row].items())
        path, own = paths[camera], cameras[camera]
        plain = None if self.by_colour else self.detected(path, own)
        if plain is not None and plain.method == "mask":
            return self, {camera: plain}
        image = read_image(path, own, colour=True)
        line = follow(image, pixel)
        if not line.count:
            if self.by_colour:
                raise InputError(path, "pixel", f"no thread at {pixel[0]:g},{pixel[1]:g}",
                                 "give another one, or --colour R,G,B")
            return self, {camera: plain}
        column, down = np.clip(np.rint(line.points).astype(int), 0, np.array(image.shape[1::-1]) - 1).T
        colour = tuple(np.median(as_colour(image)[down, column], axis=0)[::-1].tolist())
        coloured, shaded = (replace(self, options=replace(self.options, colour=colour, shaded=any_light))
                            for any_light in (False, True))
        ways = [*((coloured, self) if self.by_colour else (self, coloured)),
                *(replace(self, options=replace(self.options, polarity=polarity, width_px=line.width_px))
                  for polarity in POLARITIES), shaded]
        first = ways[0].detected(path, own) if plain is None else plain
        whole = line.take(line.strength > 0)
        if min(_shares(whole, first)) > 1 - BETTER:
            return ways[0], {camera: first}
        found = [first, *(sight.detected(path, own) for sight in ways[1:])]
        best = _best_of(pixel, whole, found, [sight.options.colour is not None for sight in ways])
        return ways[best], {camera: found[best]}

    def agreed(self, found: Sequence[Detection], row: int, paths: Sequence[Path], cameras: Sequence[Camera]) -> list[Detection]:
        """The detections ``found`` in the images of set ``row``, in all of which the thread is dark, or light: as in the image
        that was clicked, else as where it is most distinct. Images that show none so keep what was found."""
        kinds = {one.polarity for one in found if one.count and one.method != "mask"}
        if len(kinds) < 2 or self.options.polarity is not None:
            return list(found)
        clicked = None if self.clicks is None else min(self.clicks[row], default=None)
        first = max(found, key=lambda one: one.strength.sum())
        if clicked is not None and found[clicked].count:
            first = found[clicked]
        seek, agreed = replace(self, options=replace(self.options, polarity=first.polarity)), []
        for one, path, camera in zip(found, paths, cameras, strict=True):
            other = one if one.polarity in ("", first.polarity) or one.method == "mask" else seek.detected(path, camera)
            agreed.append(other if other.count else one)
        return agreed

    def with_opposite(self, found: Sequence[Detection], paths: Sequence[Path], cameras: Sequence[Camera]) -> list[Detection]:
        """The detections ``found`` in one set, and beside them lines as wide, up to a factor of two, that are dark where the
        thread is light, or light: one that is lit from a side may turn from lighter to darker than what is behind it."""
        joined = []
        for one, path, camera in zip(found, paths, cameras, strict=True):
            if one.count and one.method in METHODS:
                other = next(polarity for polarity in POLARITIES if polarity != one.polarity)
                more = replace(self, options=replace(self.options, polarity=other)).detected(path, camera)
                if 0.5 <= more.width_px / one.width_px <= 2.0:  # edges of the thread itself are nearer
                    one = one.with_parts([more.take(cKDTree(one.points).query(more.points)[0] > one.width_px)])
            joined.append(one)
        return joined

    def file(self, path: Path, camera: Camera) -> Path:
        """Where the thread is sought: the mask of the image at ``path``, or that. Raises InputError without a mask."""
        if self.masks is None:
            return path
        return self.masks[camera.name] if isinstance(self.masks, dict) else mask_of(self.masks, path)

    def remedy(self) -> str:
        """What may help the detection that is not given."""
        if self.masks is not None:
            return "mark it in the masks"
        colour = "--colour R,G,B" if self.clicks is None else "--colour clicked"
        known = {colour: self.by_colour or self.options.colour, "--polarity": self.options.polarity,
                 "--width": self.options.width_px, "--masks": None}
        return f"help the detection: {' or '.join(name for name, value in known.items() if not value)}"

    def detected(self, path: Path, camera: Camera) -> Detection:
        """The thread in the image that ``camera`` took. Raises InputError for files that are missing or do not fit."""
        options = replace(self.options, region=self.regions.get(camera.name, self.options.region))
        file = self.file(path, camera)
        mask = read_mask(file, camera)
        if mask is None and self.masks is None:
            return detect(read_image(path, camera, colour=options.colour is not None), options)
        return detect_mask(read_image(file, camera) if mask is None else mask, options)


def _best_of(pixel: tuple[float, float], path: Detection, found: Sequence[Detection], coloured: Sequence[bool]) -> int:
    """Which of several ways to seek the thread under a ``pixel`` is taken.

    path      the thread, followed from the pixel on
    found     what they detect, the first of them as options state it, the plain way
    coloured  which of them are by colour

    If the path is the whole thread, the score of a way is the harmonic mean of the share of the path that it detects and of
    the share of its points that are on the path. If the path ends early only the first share counts, and the plain way is kept
    if it detects half of the path and something at the pixel. Where it detects another line there, as a gripper's, the longer
    one is taken for the thread.
    """
    plain, shares = found[0], [_shares(path, one) for one in found]
    complete = max(only for (_, only), by in zip(shares, coloured, strict=True) if by) >= COMPLETE
    scores = [2 * has * only / max(has + only, 1e-9) if complete else has for has, only in shares]
    best = 1 + int(np.argmax(scores[1:]))
    near, elsewhere = _near(plain, pixel), shares[0][0] < ON_IT
    better = scores[best] >= max(scores[0] + BETTER if near else 0.0, ON_IT) and (complete or elsewhere or not near)
    if elsewhere and near and not coloured[0]:
        better &= len(path.points) > plain.count / POINTS_PER_PX
    return best if better else 0


def _shares(path: Detection, found: Detection) -> tuple[float, float]:
    """The share of a path that was found, and of what was found that is on the path; none of a strip of the thread."""
    if not found.count or found.width_px < STRIP * path.width_px:
        return 0.0, 0.0
    return tuple(float((cKDTree(one).query(other)[0] <= NEAR_PX).mean())
                 for one, other in ((found.points, path.points), (path.points, found.points)))


def _near(found: Detection, pixel: tuple[float, float]) -> bool:
    """Whether something was found at a pixel."""
    return bool(found.count) and np.linalg.norm(found.points - pixel, axis=1).min() <= max(CLICK_PX, found.width_px)

