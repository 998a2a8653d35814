"""From boards seen by several cameras to a rig: lenses, poses, and the uncertainty of both (§V-A).

Each camera's lens is first found alone; the cameras are then placed relative to each other through views that two of them
share; finally lenses and poses of all cameras and the poses of the board in all views are adjusted together. This bundle
adjustment minimises

    Σ |u − p(R_c (R_v x + t_v) + t_c)|²      over the corners x of the board seen at u, in px,

with one pose held, the one that the world's axes lie in, so that the normal matrix is regular and its inverse the covariance.

Axes: C cameras, V views, N corners of the board, P unknowns, F of them free.
"""

from dataclasses import dataclass, replace

import numpy as np

from doo_ti.rod.frames import cross_matrix, rotation_matrix
from doo_ti.system.errors import InputError
from doo_ti.vision.cameras import FITTED, Camera, Rig
from doo_ti.vision.synchronisation import Moved, moved_camera
from doo_ti.vision.triangulation import least_squares

FEWEST_VIEWS = 3
WORLDS = ("first-board", "camera")
COEFFICIENTS = (0, 2, 4, 5)
VAGUE = 0.05  # A focal length whose standard deviation is a larger share of it is not determined
TILT = "add views, the board tilted in several ways"
POSE = 6
MOST_STEPS = 100
LITTLE = 1e-10  # done when a step lowers the sum of squares by less than this share
WRONG, LEAST_WRONG_PX = 10.0, 1.0  # error of a corner over the median of its image, and px, from which on it is another one's
SINGULAR = 1e-13  # smallest eigenvalue of the normal matrix, its diagonal scaled to ones, that still determines all unknowns


@dataclass(frozen=True)
class Sighting:
    """The corners ``found`` (n,) of the board in the image that ``camera`` took of ``view``, at ``pixels`` (n, 2)."""

    view: int
    camera: int
    found: np.ndarray
    pixels: np.ndarray


@dataclass(frozen=True)
class Bundle:
    """C cameras and the poses x = R p + t of the board in V views: rotations (V, 3, 3), translations (V, 3) mm."""

    cameras: tuple[Camera, ...]
    rotations: np.ndarray
    translations: np.ndarray

    def residual(self, points: np.ndarray, sighting: Sighting) -> np.ndarray:
        """(n, 2) px from the seen corners to the projections of the board's corners ``points`` (N, 3)."""
        return self.cameras[sighting.camera].project(self.corners(points, sighting)) - sighting.pixels

    def corners(self, points: np.ndarray, sighting: Sighting) -> np.ndarray:
        """(n, 3) mm, in the world."""
        return points[sighting.found] @ self.rotations[sighting.view].T + self.translations[sighting.view]

    def moved(self, step: np.ndarray) -> "Bundle | None":
        """The bundle after a step (P,), which turns rotations from the left; None for focal lengths that are not positive."""
        count, cameras = len(self.cameras), []
        for camera, change in zip(self.cameras, step[: count * (FITTED + POSE)].reshape(count, -1)):
            matrix = camera.matrix.copy()
            matrix[[0, 1, 0, 1], [0, 1, 2, 2]] += change[:4]
            if not (matrix[0, 0] > 0 and matrix[1, 1] > 0):
                return None
            cameras.append(replace(camera, matrix=matrix, distortion=camera.distortion + change[4:FITTED],
                                   rotation=rotation_matrix(change[FITTED:-3]) @ camera.rotation,
                                   translation=camera.translation + change[-3:]))
        poses = step[count * (FITTED + POSE):].reshape(-1, POSE)
        return Bundle(tuple(cameras), rotation_matrix(poses[:, :3]) @ self.rotations, self.translations + poses[:, 3:])


@dataclass(frozen=True)
class Calibration:
    """A rig, the pose of the board in each view, and the errors."""

    rig: Rig
    rotations: np.ndarray  # (V, 3, 3) pose of the board in the world; NaN for a view that no camera saw
    translations: np.ndarray  # (V, 3) mm
    rms: np.ndarray  # (V, C) px: root mean square distance of the corners from their projections; NaN where none was seen
    corners: np.ndarray  # (V, C) number of corners seen
    overall_rms: float  # px, over all corners
    sigma_px: float  # standard deviation of one coordinate of a corner, estimated from the residuals
    centre_sigma: np.ndarray  # (C, 3) mm: standard deviation of the camera centres along the world's axes
    focal_sigma: np.ndarray  # (C, 2) px: of fx and fy
    alone: np.ndarray  # (C,) px: root mean square distance of a camera's corners where it is calibrated by itself
    left_out: np.ndarray  # (V, C) number of corners that were far off, among others of their image that were not
    covered: np.ndarray  # (C,) share of a camera's image that the convex hull of its corners covers
    moved: Moved | None  # a camera between two views, taken in the order given

    @property
    def worst(self) -> tuple[int, int]:
        """View and camera of the image that fits worst."""
        return tuple(int(place) for place in np.unravel_index(np.nanargmax(self.rms), self.rms.shape))


def calibrate(points: np.ndarray, sightings: list[Sighting], sizes: dict[str, tuple[int, int]], views: int,
              world: str = WORLDS[0], distortion: int = 4, source: str = "views") -> Calibration:
    """The rig that took ``sightings`` of a board with corners ``points`` (N, 3) mm, in ``views`` views.

    sizes       name: width and height in px of each of C cameras, in the order in which the sightings number them
    world       of WORLDS, the world's axes: ``first-board``, those of the board in the first view: origin at its first inner
                corner, x along a row, y up the page, z out of the board; or ``camera``, those of the first camera
    distortion  of COEFFICIENTS, how many of k1, k2, p1, p2, k3 are fitted, the others being 0. The fifth helps for wide lenses
                whose images show corners up to the border; otherwise it only adds noise

    Single corners that are far off, because another one was taken for them, are left out.

    Raises InputError, naming ``source``, for a camera with fewer than three views of the board or without a view shared with
    the others, for a first view without board if that defines the world, and for views that do not determine the cameras.
    """
    names = tuple(sizes)
    _check(sightings, names, world, source)
    cameras, poses, alone = _lenses(points, sightings, sizes, distortion, source)
    bundle = _placed(points, sightings, cameras, poses, views, source)
    if world == "first-board":
        turn, shift = bundle.rotations[0], bundle.translations[0]
        cameras = tuple(replace(one, rotation=one.rotation @ turn, translation=one.rotation @ shift + one.translation)
                        for one in bundle.cameras)
        bundle = Bundle(cameras, turn.T @ bundle.rotations, (bundle.translations - shift) @ turn)
    lenses, of_cameras, of_views = places(len(names), views)
    free = np.ones(of_views[-1, -1] + 1, dtype=bool)
    free[lenses[:, 4 + distortion:]] = False
    free[of_cameras[0] if world == "camera" else of_views[0]] = False
    free[of_views[np.isnan(bundle.translations[:, 0])]] = False
    try:
        bundle, covariance = adjusted(bundle, points, sightings, free)
    except np.linalg.LinAlgError:
        raise InputError(source, "views", "they do not determine the cameras", TILT) from None
    except InputError:  # of a lens that cannot be
        raise InputError(source, "views", "the cameras do not agree about the board", "give images of one moment in each row, "
                         "none mirrored or turned (--orientation)") from None
    calibration = _calibration(bundle, covariance, points, sightings, free, alone, source)
    kept = [_without_wrong_corners(bundle, points, sighting) for sighting in sightings]
    if any(len(some.found) < len(every.found) for some, every in zip(kept, sightings)):
        again = calibrate(points, kept, sizes, views, world, distortion, source)
        return replace(again, left_out=calibration.corners - again.corners)
    moved = calibration.moved
    remedy = TILT if moved is None else (f"{' or '.join(names[camera] for camera in moved.cameras)} moved before view number "
                                         f"{moved.view + 1}: give only the views before, or those from there on")
    for camera, sigma in zip(calibration.rig.cameras, calibration.focal_sigma[:, 0]):
        if not sigma < VAGUE * camera.matrix[0, 0]:
            problem = f"its focal length would be {camera.matrix[0, 0]:.0f} px ± {sigma:.0f}"
            raise InputError(source, camera.name, problem, remedy)
    return calibration


def _without_wrong_corners(bundle: Bundle, points: np.ndarray, sighting: Sighting) -> Sighting:
    """``sighting`` without corners that another corner or marker was taken for: far off beside the others of their image."""
    off = np.linalg.norm(bundle.residual(points, sighting), axis=-1)
    kept = off < max(WRONG * np.median(off), LEAST_WRONG_PX)
    return replace(sighting, found=sighting.found[kept], pixels=sighting.pixels[kept])


def _check(sightings: list[Sighting], names: tuple[str, ...], world: str, source: str) -> None:
    for camera, name in enumerate(names):
        seen = sum(sighting.camera == camera for sighting in sightings)
        if seen < FEWEST_VIEWS:
            raise InputError(source, name, f"the board was found in {seen} of its images",
                             f"give {FEWEST_VIEWS} that show it, or more: ten are good")
    if world == "first-board" and not any(sighting.view == 0 for sighting in sightings):
        raise InputError(source, "view", "the board was found in no image of the first view, where the world's axes lie",
                         "put another view first, or choose the camera as the world")


def _lenses(points, sightings, sizes, distortion: int, source: str
            ) -> tuple[list[Camera], dict[tuple[int, int], tuple], np.ndarray]:
    """Each camera by itself, at the world's origin, (view, camera): R and t of the board in front of it, and (C,) px, root mean
    square, how far corners are off then."""
    import cv2

    fixed = {0: cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST,
             2: cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST, 4: cv2.CALIB_FIX_K3, 5: 0}[distortion]
    cameras, poses, alone = [], {}, []
    for index, (name, size) in enumerate(sizes.items()):
        own = [sighting for sighting in sightings if sighting.camera == index]
        threads = cv2.getNumThreads()
        cv2.setNumThreads(1)  # the order of sums over several threads, and so the last digits, differ from run to run
        try:
            error, matrix, coefficients, turns, shifts = cv2.calibrateCamera(
                [points[sighting.found].astype(np.float32) for sighting in own],
                [sighting.pixels.astype(np.float32) for sighting in own], size, None, None, flags=fixed)
        except cv2.error:
            raise InputError(source, name, "the views do not determine its lens", TILT) from None
        finally:
            cv2.setNumThreads(threads)
        cameras.append(Camera(name, *size, matrix, np.ravel(coefficients)[:5], np.eye(3), np.zeros(3)))
        for sighting, turn, shift in zip(own, turns, shifts):
            poses[sighting.view, index] = cv2.Rodrigues(turn)[0], np.ravel(shift)
        alone.append(error)
    return cameras, poses, np.array(alone)


def _placed(points, sightings, cameras, poses, views: int, source: str) -> Bundle:
    """All cameras and boards in the axes of the first camera, each through the shared view that agrees best with the others.

    A flat board far away looks nearly the same from two sides, so that a single view may give the wrong pose.
    """
    by_camera = [{sighting.view: sighting for sighting in sightings if sighting.camera == index}
                 for index in range(len(cameras))]
    known = {0: cameras[0]}
    while len(known) < len(cameras):
        shared = {(near, far): by_camera[near].keys() & by_camera[far].keys()
                  for near in known for far in range(len(cameras)) if far not in known}
        near, far = max(shared, key=lambda pair: len(shared[pair]))
        common = sorted(shared[near, far])
        if not common:
            lost = [camera.name for index, camera in enumerate(cameras) if index not in known]
            others = ", ".join(camera.name for camera in known.values())
            raise InputError(source, lost[0], f"not connected: shares no view of the board with {others}",
                             "add views that both see")
        boards, candidates = {view: _board_pose(known[near], *poses[view, near]) for view in common}, []
        for view in common:
            (seen_turn, seen_shift), (turn, shift) = poses[view, far], boards[view]
            rotation = seen_turn @ turn.T
            candidates.append(replace(cameras[far], rotation=rotation, translation=seen_shift - rotation @ shift))
        known[far] = min(candidates, key=lambda camera: np.median([
            _rms(camera, points, by_camera[far][view], *boards[view]) for view in common]))
    rotations, translations = np.full((views, 3, 3), np.nan), np.full((views, 3), np.nan)
    for view in sorted({sighting.view for sighting in sightings}):
        seeing = [index for index in range(len(cameras)) if view in by_camera[index]]
        candidates = [_board_pose(known[index], *poses[view, index]) for index in seeing]
        rotations[view], translations[view] = min(candidates, key=lambda pose: sum(
            _rms(known[index], points, by_camera[index][view], *pose) for index in seeing))
    return Bundle(tuple(known[index] for index in range(len(cameras))), rotations, translations)


def _board_pose(camera: Camera, rotation: np.ndarray, translation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pose in the world of a board that is at a pose in front of ``camera``."""
    return camera.rotation.T @ rotation, camera.rotation.T @ (translation - camera.translation)


def _rms(camera: Camera, points: np.ndarray, sighting: Sighting, rotation: np.ndarray, translation: np.ndarray) -> float:
    """px; infinite where the board is not in front of the camera."""
    residual = camera.project(points[sighting.found] @ rotation.T + translation) - sighting.pixels
    mean = np.mean(np.sum(residual**2, axis=-1))
    return float(np.sqrt(mean)) if np.isfinite(mean) else np.inf


def _calibration(bundle: Bundle, covariance: np.ndarray, points, sightings, free, alone: np.ndarray, source: str
                 ) -> Calibration:
    """The adjusted bundle and its covariance as a rig with its errors."""
    import cv2

    shape = len(bundle.rotations), len(bundle.cameras)
    lenses, of_cameras, _ = places(shape[1], shape[0])
    rms, corners = np.full(shape, np.nan), np.zeros(shape, dtype=np.int64)
    squares, covered = 0.0, np.empty(shape[1])
    for sighting in sightings:
        square = np.sum(bundle.residual(points, sighting) ** 2)
        corners[sighting.view, sighting.camera] = len(sighting.found)
        rms[sighting.view, sighting.camera] = np.sqrt(square / len(sighting.found))
        squares += square
    sigma = np.sqrt(squares / max(2 * corners.sum() - free.sum(), 1))
    centre_sigma, focal_sigma = np.empty((shape[1], 3)), np.empty((shape[1], 2))
    for index, camera in enumerate(bundle.cameras):
        # c = −Rᵀ t; R turns by w about the camera's axes, t moves by s: δc = −Rᵀ (t × w + s).
        by_pose = -camera.rotation.T @ np.hstack([cross_matrix(camera.translation), np.eye(3)])
        pose = covariance[np.ix_(of_cameras[index], of_cameras[index])]
        centre_sigma[index] = sigma * np.sqrt(np.diag(by_pose @ pose @ by_pose.T))
        focal_sigma[index] = sigma * np.sqrt(np.diag(covariance)[lenses[index, :2]])
        seen = np.concatenate([sighting.pixels for sighting in sightings if sighting.camera == index])
        covered[index] = cv2.contourArea(cv2.convexHull(seen.astype(np.float32))) / (camera.width * camera.height)
    return Calibration(Rig(bundle.cameras, source), bundle.rotations, bundle.translations, rms, corners,
                       float(np.sqrt(squares / corners.sum())), float(sigma), centre_sigma, focal_sigma, alone,
                       np.zeros_like(corners), covered, moved_camera(
                           [(s.view, s.camera, *_linearised(bundle, points, s)) for s in sightings], covariance))


# --- bundle adjustment -----------------------------------------------------------------------------------------------------

def adjusted(bundle: Bundle, points: np.ndarray, sightings: list[Sighting], free: np.ndarray) -> tuple[Bundle, np.ndarray]:
    """The bundle with the least squared distances between ``sightings`` and projections of the board's corners ``points``
    (N, 3), and the covariance (P, P) of its unknowns for a standard deviation of one pixel, in the order of :func:`places`.

    free  (P,) bool: unknowns that are fitted; the others are fixed, with zero covariance. At least one pose must be fixed.

    Raises LinAlgError where the sightings do not determine the free unknowns.
    """
    def moved(bundle, steps):
        step = np.zeros(len(free))
        step[free] = steps[0]
        return bundle.moved(step)

    bundle, _, normal = least_squares(
        bundle, lambda trial: _normal_equations(trial, points, sightings, free), moved,
        lambda better, trial, before: trial if better[0] else before,
        lambda step, gain, cost: (gain >= 0) & (gain <= LITTLE * cost), 1e-3, MOST_STEPS)
    covariance = np.zeros((len(free), len(free)))
    covariance[np.ix_(free, free)] = _inverse(normal[0])
    return bundle, covariance


def places(cameras: int, views: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Indices of the lenses (C, 9), the cameras' poses (C, 6) and the board's poses (V, 6) among P unknowns; of a pose first
    the rotation, then t."""
    of_cameras = np.arange(cameras * (FITTED + POSE)).reshape(cameras, -1)
    of_views = cameras * (FITTED + POSE) + np.arange(views * POSE).reshape(views, POSE)
    return of_cameras[:, :FITTED], of_cameras[:, FITTED:], of_views


def _normal_equations(bundle: Bundle | None, points: np.ndarray, sightings: list[Sighting], free: np.ndarray):
    """(1,) px² the sum of squares, infinite for corners that are not in front of their camera and without a bundle, (1, F, F)
    JᵀJ and (1, F) Jᵀr of the free unknowns."""
    normal, slope, cost = np.zeros((len(free), len(free))), np.zeros(len(free)), np.inf if bundle is None else 0.0
    for sighting in [] if bundle is None else sightings:
        residual, jacobian, at = _linearised(bundle, points, sighting)
        normal[np.ix_(at, at)] += jacobian.T @ jacobian
        slope[at] += jacobian.T @ residual
        cost += residual @ residual
    cost = cost if np.isfinite(cost) else np.inf
    return np.array([cost]), normal[np.ix_(free, free)][None], slope[free][None]


def _linearised(bundle: Bundle, points: np.ndarray, sighting: Sighting) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(2n,) px errors of a sighting, (2n, K) their slopes by the lens and the poses of camera and board, and (K,) the places of
    these among the unknowns."""
    lenses, of_cameras, of_views = places(len(bundle.cameras), len(bundle.rotations))
    camera, world = bundle.cameras[sighting.camera], bundle.corners(points, sighting)
    pixel, by_point, by_lens = camera.project_with_jacobian(world)
    by_world = by_point @ camera.rotation
    jacobian = np.concatenate([
        by_lens, -by_point @ cross_matrix(world @ camera.rotation.T), by_point,
        -by_world @ cross_matrix(world - bundle.translations[sighting.view]), by_world], axis=-1)
    at = np.concatenate([lenses[sighting.camera], of_cameras[sighting.camera], of_views[sighting.view]])
    return (pixel - sighting.pixels).ravel(), jacobian.reshape(-1, jacobian.shape[-1]), at


def _inverse(normal: np.ndarray) -> np.ndarray:
    """The inverse by way of a matrix scaled to ones on its diagonal: units differ by many powers of ten."""
    scale = 1 / np.sqrt(np.maximum(np.diag(normal), np.finfo(float).tiny))
    scaled = normal * scale * scale[:, None]
    if not np.linalg.eigvalsh(scaled)[0] > SINGULAR:
        raise np.linalg.LinAlgError("the normal matrix is singular")
    return np.linalg.inv(scaled) * scale * scale[:, None]
