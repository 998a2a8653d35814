"""The most probable rod on the detected points, and its uncertainty (§IV-A; docs/perception.md).

Distance maps have a value for each pixel, and their valley lies up to 0.2 px beside the line, now to this side and now to that.
Where the thread runs along its epipolar lines, that is millimetres of depth. So the rod found is relaxed again, under E/B and

    ν E_back = ν Σ_c Σ_k w_k ρ(n·(p(x_k) − q_k)),        ν = T / 2N,        doo_ti.vision.image_energy

with q_k the middle of the detected points around the image of place k, and n across the line there. After each relaxation it is
found anew which point is whose, and with r, how far place k is off its line, the weight w_k: the px of line there over
(1 + r²/h²)². So ρ is Geman's and McClure's, as where strands touch or cross their lines merge, a pixel off both. Along the line
a place is free, but the ends of the rod are held where they were, as firmly as ends of lines are found, else rods would fold in
depth between cameras close together: the start where that is not exact, and the last place if it moves by more than a width.
Places without points of their direction near them have no weight: the rod's stiffness alone bridges gaps. Nor have those nearer
to an end of a line, or a gap, than it is wide, where edges of what holds or hides the thread draw it aside, those beyond, on
lines far wider than the thread, those as near to other strands, and those where the line of some camera leaves the rod: the end
of a rod longer than its lines else folds in depth, on the lines of other cameras. Where the rod runs as close to itself,
as in a hairpin, or bends as sharply, the line lies somewhere between both strands: such places count (h / width)².

A piece that one camera alone sees takes up what the rod is too long by: it bulges along the line of sight, and noise that the
rod follows elsewhere keeps it from moving along the lines. Such rods are relaxed with 20 N and 20 h² first.

Around that rod the Laplace approximation has

    cov = (∫ a aᵀ ds / N + H_E / T)⁻¹,        N = σ² ℓ,        T = E / J.

Detected points have errors of σ px across the line, equal within a length ℓ of the line; the movement of places of the image
across the image, per parameter, is a. Where the line is off the rod by more than that, N is measured. What moves a rod is not
the scatter of points, which averages out, but what neighbours are off together: with d px across the rod's image, in K sections
of L px, longer than what noise has in common and shorter than what a rod can follow,

    N = Q K / (K − γ),        Q = L · mean of (mean of d in a section)²                                    px³

for a rod whose images determine γ of its parameters follows as many sections (MacKay 1992). Besides noise Q has all that keeps
the rod off the line: glints, cameras that disagree about where the thread is, bends that are too sharp for the rod.

H_E is the Hessian of the rod's bending energy E over its stiffness. How strongly rods of this kind bend is taken from the rod
itself: with J joints the mean of E is J T in a Gaussian density e^{−E/T}. Where images say little, as of the depth where
cameras are close together, the rod's stiffness is all that is known, and sigma is large. Rest lengths count as exact, as do a
seed whose σ is not given, and the rig where its errors do not keep the rod off the lines. Where the start may be farther along,
the rod slides as a whole: its ends alone hold that. An end that kinks as the rod does nowhere else is that uncertain: it
follows what holds it.

Sensor noise alone moves detected points by about 0.02 px, over about 4 px of line; the default σ and ℓ of
:class:`doo_ti.perception.search.PerceptionOptions` are larger, as are errors on renderings of known rods.

Axes: A rods of as many image sets, C cameras, E edges, V vertices, K places along an edge, S places along a rod, P = 3 + 2 E
parameters: the place of the first vertex, and turns of the edges.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from doo_ti.contact.surroundings import Surroundings
from doo_ti.relaxation.newton import Newton
from doo_ti.relaxation.relax import relax
from doo_ti.rod.frames import across, normal_to
from doo_ti.rod.shapes import end_clamps
from doo_ti.rod.types import Clamp, Configuration, Material, Status, put_rods
from doo_ti.vision.cameras import Rig
from doo_ti.vision.detection import NEAR_PX, Detection
from doo_ti.vision.distance_map import coverage, of_thread
from doo_ti.vision.image_energy import AssignedPoints
from doo_ti.vision.paths import Lines, contradicted, line_trees, lines_at, merged

PLACES = np.array([0.25, 0.75])  # along an edge where its image is evaluated
RELAXATIONS, STILL_MM = 10, 0.01  # at most, until no vertex moves by more
LOOSE = 20.0  # N of the first relaxations of rods of which one camera alone sees a piece, over that of the last ones
TOLERANCE = 1e-5  # of their residuals: points, of which many pull, are known to f32
MERGED_PX = 0.3  # h: where the line is farther off the rod, other strands are likely to have moved it
LAST = np.s_[:, :, -1, -1]  # of (A, C, E, K) places
NOISE_PX3 = 0.05  # N, of the usual σ and ℓ; a line's end has the weight N over the variance of where the line ends
TURNING, STRAIGHT = 2.0, 0.06  # rad that rods turn by at least, for T in ν and for T in the covariance
FEWEST_CHANGES = 5  # changes of curvature along a rod: of fewer, none is said to be larger than the others
COVERED = 0.95  # share of a detected line with which a rod is one of the whole thread
ALONG = 1e-3  # share that counts of a distance along the line
EXACT = 1e-8  # mm² and rad²: variance of a start that is given
STEP_MM = 1e-3  # step of the difference quotients of the projection
ROUNDS, LEAST_FREE = 6, 0.2  # rounds in which N and γ are found, and the least share of sections that a rod does not follow
SECTION_PX = 20.0  # L


def sharpened(rods: Configuration, rig: Rig, detections: Sequence[Sequence[Detection]], material: Material, up: np.ndarray,
              surroundings: Surroundings, exact: np.ndarray, marks: int) -> tuple[Configuration, np.ndarray]:
    """``rods`` (A), each with so many ``marks``, relaxed under E + ν E_back, and (A,) bool: those that end at certified minima
    and still explain the lines. Others stay as they were. Where ``exact`` (A,) the first edge is held."""
    every = np.arange(len(rods.start))
    start, quaternions, sound = rods.start.copy(), rods.quaternions.copy(), np.zeros(len(every), dtype=bool)
    pieces, stiffness = (len(rods.vertices[0]) - 1) // (marks - 1), float(np.linalg.eigvalsh(material.bend).max())
    nu = temperature(rods.vertices[:, ::pieces], marks, TURNING) / (2 * NOISE_PX3)
    (given, ways), (thread, lines, width) = _images_of_places(rig, rods.vertices), _lines_of(detections)
    end_weight = np.array([[NOISE_PX3 / detection.end_sigma**2 for detection in images] for images in detections])
    share, kept = _counting(given, lines_at(given, ways, lines)[2], lines, width, exact)
    for loosely, moving in ((LOOSE, np.flatnonzero(_seen_once(kept))), (1.0, every)):
        for _ in range(RELAXATIONS):
            if not len(moving):
                break
            here = Configuration(start, quaternions, rods.rest_length).take(moving)
            places, ways = _images_of_places(rig, here.vertices)
            own, held, part = [lines[row] for row in moving], exact[moving], share[moving]
            points, tangents, found = lines_at(places, ways, own)
            shown = found & kept[moving] if loosely > 1 else _shown(places, found & (part > 0), own, width[moving], held)
            square = tangents[..., ::-1] * [1.0, -1.0]
            off = ((places - points) * square).sum(axis=-1)
            weight = part * shown * np.linalg.norm(ways, axis=-1) / len(PLACES)
            weight /= (1 + (off / MERGED_PX) ** 2 / loosely) ** 2
            slid, free = ((places - given[moving]) * tangents)[LAST].sum(axis=-1), 0.0 if loosely > 1 else width[moving, :, 0]
            too_far = found[LAST] & (np.abs(slid) > free)
            points[LAST] = given[moving][LAST] + np.clip(slid, -free, free)[..., None] * tangents[LAST]
            tangents[LAST], weight[LAST] = square[LAST], np.where(too_far, end_weight[moving], 0.0)
            points[~held, :, 0, 0] = given[moving[~held], :, 0, 0]
            tangents[~held, :, 0, 0] = square[~held, :, 0, 0]
            weight[~held, :, 0, 0] = np.where(found[~held, :, 0, 0], loosely * end_weight[moving[~held]], 0.0)
            clamps = replace(end_clamps(here), start=np.where(held, Clamp.TANGENT, Clamp.FREE))
            pull = AssignedPoints(rig, points, tangents, nu[moving, None, None, None] / loosely * weight, stiffness, ALONG)
            solution = relax(here, material, clamps, Newton(TOLERANCE), up=up, precision="mixed", external=pull,
                             external_index=np.arange(len(moving)), **surroundings.arguments)
            start[moving], quaternions[moving] = solution.configuration.start, solution.configuration.quaternions
            sound[moving] = (solution.status == Status.CONVERGED) & solution.stable
            moving = moving[np.abs(solution.configuration.vertices - here.vertices).max(axis=(1, 2)) > STILL_MM]
    new = Configuration(start, quaternions, rods.rest_length)
    before, after = (coverage(rig, shape.vertices, every, thread, NEAR_PX).share for shape in (rods, new))
    sound &= (after >= np.minimum(before, COVERED)).all(axis=1)
    return put_rods(rods, sound, new.take(sound)), sound


def _counting(places: np.ndarray, found: np.ndarray, lines: Lines, width: np.ndarray, exact: np.ndarray
              ) -> tuple[np.ndarray, np.ndarray]:
    """(A, C, E, K) twice: the share that ``places`` count, none beside other strands, and bool: those that do and are
    :func:`_shown`."""
    others, itself = merged(places, inside_ends(places, found, width, exact), lines, width)
    share = np.where(itself, (MERGED_PX / np.maximum(width, MERGED_PX)[..., None]) ** 2, 1.0) * ~others
    return share, _shown(places, found & ~others, lines, width, exact)


def _shown(places: np.ndarray, found: np.ndarray, lines: Lines, width: np.ndarray, exact: np.ndarray) -> np.ndarray:
    """(A, C, E, K) bool: those of ``places`` at which the rod's line is ``found`` that are :func:`inside_ends`, and not
    :func:`contradicted`."""
    return inside_ends(places, found, width, exact) & ~contradicted(places, found, lines)[:, None]


def inside_ends(places: np.ndarray, found: np.ndarray, width: np.ndarray, exact: np.ndarray) -> np.ndarray:
    """(A, C, E, K) bool: those of the ``places`` (A, C, E, K, 2) px of rods' images at which the line is ``found`` (A, C, E, K)
    that are farther than its ``width`` (A, C, 1) px from where it ends, or is hidden, but for a start that is ``exact`` (A,).
    Nearer to its end a line is drawn aside by the edges of what holds it, or hides it, or is behind it."""
    flat = places.reshape(*places.shape[:2], -1, 2)
    along = np.pad(np.cumsum(np.linalg.norm(np.diff(flat, axis=2), axis=-1), axis=2), ((0, 0), (0, 0), (1, 0)))
    there = found.reshape(along.shape)
    before, after = np.roll(there, 1, axis=2), np.roll(there, -1, axis=2)
    before[..., 0], after[..., -1] = exact[:, None], False
    first = np.maximum.accumulate(np.where(there & ~before, along, -np.inf), axis=2)
    last = np.minimum.accumulate(np.where(there & ~after, along, np.inf)[..., ::-1], axis=2)[..., ::-1]
    return (there & (along <= last - width) & (along >= first + width)).reshape(found.shape)


def _seen_once(shown: np.ndarray) -> np.ndarray:
    """(A,) bool: rods of which one camera alone sees most of a gap between pieces ``shown`` (A, C, E, K) by several."""
    count = shown.sum(axis=1).reshape(len(shown), -1)
    gap = _between(count > 1) & (count < 2)
    return (gap & (count == 1)).sum(axis=1) > 0.5 * gap.sum(axis=1)


def _between(there: np.ndarray) -> np.ndarray:
    """(…, S) bool: all from the first to the last of those that are ``there`` (…, S)."""
    return np.maximum.accumulate(there, axis=-1) & np.maximum.accumulate(there[..., ::-1], axis=-1)[..., ::-1]


def _lines_of(detections: Sequence[Sequence[Detection]]) -> tuple[list[list[Detection]], Lines, np.ndarray]:
    """The ``detections`` without lines that are far wider than the thread, these lines, and (A, C, 1) px: its width."""
    thread = [[of_thread(found) for found in images] for images in detections]
    return thread, line_trees(thread), np.nan_to_num([[[found.width_px] for found in images] for images in detections])


def temperature(vertices: np.ndarray, marks: int, least_turn: float) -> np.ndarray:
    """(A,) 1/mm: T, how strongly rods (A, V, 3) with so many ``marks`` bend, at least as those that turn by ``least_turn``."""
    edges = np.diff(vertices, axis=1)
    length = np.linalg.norm(edges, axis=-1)
    turns = np.linalg.norm(np.diff(edges / length[..., None], axis=1), axis=-1)
    bending = (turns**2 * 2.0 / (length[:, :-1] + length[:, 1:])).sum(axis=1)
    return np.maximum(bending, least_turn**2 / length.sum(axis=1)) / (marks - 2)


def _images_of_places(rig: Rig, vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(A, C, E, K, 2) px: where cameras see the places, and the images of their edges."""
    image = np.nan_to_num(rig.project(vertices).swapaxes(0, 1), nan=-1e6)
    edge = np.diff(image, axis=2)[:, :, :, None]
    return image[:, :, :-1, None] + PLACES[:, None] * edge, np.repeat(edge, len(PLACES), axis=3)


# --- its uncertainty -------------------------------------------------------------------------------------------------------

def vertex_sigma(rig: Rig, vertices: np.ndarray, sigma_px: float, correlation_px: float, scatter: np.ndarray | float = 0.0,
                 detected: np.ndarray | None = None, start_covariance: np.ndarray | float = 0.0) -> np.ndarray:
    """(A, V) mm: standard deviation of each vertex, root mean square over x, y, z; of inner ones for a rod that does not slide.

    vertices                   (A, V, 3) mm: rods at minima of E_vis / B, isotropic and straight at rest
    sigma_px, correlation_px   σ and ℓ of the detection, at least
    scatter, detected          (A,) px³ and (A, C S) of :func:`detected_places`; None: all of the thread was detected
    start_covariance           (A, 3, 3) mm² of the first vertex, before the images are looked at; zero: its edge is given
    """
    edges = np.diff(vertices, axis=1)
    length = np.linalg.norm(edges, axis=-1)
    tangents = edges / length[..., None]
    first = across(tangents)
    turns = np.stack([first, np.cross(tangents, first)], axis=-1)  # (A, E, 3, 2)
    ways, moved = _at_vertices(tangents), _vertex_movement(turns, length)  # (A, V, 3), and (A, V, 3, P)
    seen, image_length = _movement_across(rig, vertices, ways, moved)
    if detected is not None:
        image_length = image_length * detected
    seen_once = np.swapaxes(seen, -1, -2) @ (image_length[..., None] * seen)
    kept = _not_slid(ways, turns, length)
    stiff = np.swapaxes(kept, -1, -2) @ bending_hessian(turns, length) @ kept
    stiff /= temperature(vertices, vertices.shape[1], STRAIGHT)[:, None, None]
    start = np.broadcast_to(start_covariance, (len(vertices), 3, 3))
    free = start.any(axis=(1, 2))
    stiff[:, :3, :3] += np.linalg.inv(start + EXACT * np.eye(3))
    stiff[:, [3, 4], [3, 4]] += np.where(free, 1.0, 1 / EXACT)[:, None]  # where it is free, its direction is known to a radian
    noise, sections = np.full(len(vertices), sigma_px**2 * correlation_px), image_length.sum(axis=1) / SECTION_PX
    for _ in range(ROUNDS):
        covariance = np.linalg.inv(seen_once / noise[:, None, None] + stiff)
        followed = np.einsum("apq,aqp->a", covariance, seen_once) / noise
        measured = scatter * sections / np.maximum(sections - followed, np.maximum(LEAST_FREE * sections, 1e-9))
        noise = np.maximum(measured, sigma_px**2 * correlation_px)
    covariance = np.linalg.inv(seen_once / noise[:, None, None] + stiff)
    variance = np.einsum("avxp,apq,avxq->av", moved, covariance, moved, optimize=True)
    slid = np.einsum("apx,ax->ap", covariance[:, :, :3], ways[:, 0])
    slid /= np.sqrt((slid[:, :3] * ways[:, 0]).sum(axis=1, keepdims=True))  # by one standard deviation
    variance[:, 1:-1] -= (np.einsum("avxp,ap->avx", moved[:, 1:-1], slid) ** 2).sum(axis=-1)
    variance[:, [0, -1]] += (_kinks(tangents, length) * np.stack([free, np.ones_like(free)], axis=1)) ** 2
    if detected is not None:
        variance += _unseen_ends(detected, length, vertices, free[:, None]) ** 2
    return np.sqrt(np.maximum(variance, 0.0) / 3)


def _kinks(tangents: np.ndarray, length: np.ndarray) -> np.ndarray:
    """(A, 2) mm by which the first and the last vertex are beside where the rod would go on, its curvature changing as evenly
    as anywhere else: no elastic rod turns so at its end, but a line beside it does, of what holds it."""
    middle = 0.5 * (length[:, 1:] + length[:, :-1])
    uneven = np.linalg.norm(np.diff(np.diff(tangents, axis=1) / middle[..., None], axis=1), axis=-1)  # curvature's changes
    if uneven.shape[1] < FEWEST_CHANGES:
        return np.zeros((len(length), 2))
    more = np.maximum(uneven[:, [0, -1]] - uneven[:, 1:-1].max(axis=1)[:, None], 0.0)
    return more * middle[:, [0, -1]] * length[:, [0, -1]]


def _unseen_ends(detected: np.ndarray, length: np.ndarray, vertices: np.ndarray, free: np.ndarray) -> np.ndarray:
    """(A, V) mm by which vertices beyond the places that two cameras show are aside if the rod bends there to one side, as much
    as on average; at its start where that is ``free`` (A, 1). H_E has it bend now to this side, now to that."""
    arc, half = np.pad(np.cumsum(length, axis=1), ((0, 0), (1, 0))), np.repeat(0.5 * length, 2, axis=1)
    end = np.cumsum(half, axis=1)  # of what is around each place
    shown = np.sort(detected.reshape(len(arc), -1, half.shape[1]), axis=1)[:, -2:].min(axis=1)
    first = np.where(shown > 0, end - shown * half, arc[:, -1:]).min(axis=1)
    last = np.where(shown > 0, end - (1 - shown) * half, 0.0).max(axis=1)
    before = np.where(free, np.maximum(first[:, None] - arc, 0.0), 0.0)
    beyond = np.maximum(arc - last[:, None], 0.0)
    curvature = np.sqrt(temperature(vertices, vertices.shape[1], STRAIGHT) / length.mean(axis=1))
    return 0.5 * curvature[:, None] * np.maximum(before, beyond) ** 2


def _vertex_movement(turns: np.ndarray, length: np.ndarray) -> np.ndarray:
    """(A, V, 3, P) mm, or mm per rad: derivative of each vertex by the place of the first one and by turns of the edges."""
    rods, edges = length.shape
    each = length[..., None, None] * turns
    before = np.tri(edges + 1, edges, -1)
    moved = before[None, :, :, None, None] * each[:, None]
    turned = np.moveaxis(moved, 2, 3).reshape(rods, edges + 1, 3, 2 * edges)
    return np.concatenate([np.broadcast_to(np.eye(3), (*turned.shape[:3], 3)), turned], axis=-1)


def _at_vertices(tangents: np.ndarray) -> np.ndarray:
    """(A, V, 3) directions of a smooth rod at its vertices, by those of its edges (A, E, 3)."""
    around = np.pad(tangents, ((0, 0), (1, 1), (0, 0)), mode="reflect", reflect_type="odd")
    return 0.5 * (around[:, 1:] + around[:, :-1])


def _not_slid(ways: np.ndarray, turns: np.ndarray, length: np.ndarray) -> np.ndarray:
    """(A, P, P): takes out of parameters the slide of the rod along itself, in directions ``ways`` (A, V, 3) of its vertices,
    by as much as its start moves along it."""
    slide = np.einsum("aexu,aex->aeu", turns, np.diff(ways, axis=1)) / length[..., None]
    slide = np.concatenate([ways[:, 0], slide.reshape(len(ways), -1)], axis=1)
    along = np.pad(ways[:, 0] / (ways[:, 0] ** 2).sum(axis=1, keepdims=True), ((0, 0), (0, slide.shape[1] - 3)))
    return np.eye(slide.shape[1]) - slide[:, :, None] * along[:, None]


def _movement_across(rig: Rig, vertices: np.ndarray, ways: np.ndarray, moved: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """((A, C S, P) px per rad: movement of places of the rod's images across these; (A, C S) px: length of image per place).
    Across the images of smooth rods: corners of others would not slide along them."""
    rows, shares = [], []
    for part in PLACES:
        place = (1 - part) * vertices[:, :-1] + part * vertices[:, 1:]
        motion = (1 - part) * moved[:, :-1] + part * moved[:, 1:]  # (A, E, 3, P)
        ahead = STEP_MM * np.eye(3)
        jacobian = (rig.project(place[:, :, None] + ahead) - rig.project(place[:, :, None] - ahead)) / (2 * STEP_MM)
        pixels = np.linalg.norm(np.einsum("caexu,aex->caeu", jacobian, np.diff(vertices, axis=1)), axis=-1)
        along = np.einsum("caexu,aex->caeu", jacobian, (1 - part) * ways[:, :-1] + part * ways[:, 1:])
        normal = normal_to(along) / np.maximum(np.linalg.norm(along, axis=-1), 1e-9)[..., None]
        rows.append(np.einsum("caexu,caeu,aexp->acep", jacobian, normal, motion, optimize=True))
        shares.append(np.swapaxes(pixels, 0, 1) / len(PLACES))
    across_image, share = np.stack(rows, axis=3), np.stack(shares, axis=3)
    # Places that a camera cannot see do not count.
    blind = ~(np.isfinite(across_image).all(axis=-1) & np.isfinite(share))
    across_image[blind], share[blind] = 0.0, 0.0
    return across_image.reshape(len(vertices), -1, across_image.shape[-1]), share.reshape(len(vertices), -1)


def detected_places(rig: Rig, vertices: np.ndarray, pieces: int, detections: Sequence[Sequence[Detection]]
                    ) -> tuple[np.ndarray, np.ndarray]:
    """Of rods ``vertices`` (A, V, 3) mm whose edges are cut into ``pieces``: (A, C S) the share that was detected of the image
    around each place, as :func:`sharpened` takes the lines, and (A,) px³: Q of all cameras there."""
    (places, ways), (_, lines, width) = _images_of_places(rig, vertices), _lines_of(detections)
    (points, tangents, found), exact = lines_at(places, ways, lines), np.zeros(len(vertices), dtype=bool)
    share, shown = _counting(places, found, lines, width, exact)
    length = np.linalg.norm(ways, axis=-1) / len(PLACES)
    section = (np.cumsum(length.reshape(*length.shape[:2], -1), axis=2).reshape(length.shape) / SECTION_PX).astype(np.int64)
    there = _between(found.reshape(*found.shape[:2], -1)).reshape(found.shape)
    weight = length * (found & inside_ends(places, there, width, exact))
    moment, squares = weight * ((places - points) * normal_to(tangents)).sum(axis=-1), [[[0.0]] for _ in found]
    for row, c in np.ndindex(found.shape[:2]):
        total, mean = (np.bincount(section[row, c].ravel(), one[row, c].ravel()) for one in (weight, moment))
        squares[row].append((mean / np.maximum(total, 1e-9))[total > SECTION_PX / 2] ** 2)
    scatter = SECTION_PX * np.array([sum(map(np.sum, one)) / max(sum(map(len, one)) - 1, 1) for one in squares])
    return (share * shown).reshape(len(shown), -1, pieces).mean(axis=-1), scatter


def bending_hessian(turns: np.ndarray, length: np.ndarray) -> np.ndarray:
    """(A, P, P) 1/mm: second derivative of Σ |κb|²/l̄, with κb as the difference of tangents. The first vertex has no part."""
    rods, edges = length.shape
    joint = 2.0 / (length[:, :-1] + length[:, 1:])
    diagonal, beside = np.zeros((rods, edges)), -joint
    diagonal[:, :-1] += joint
    diagonal[:, 1:] += joint
    blocks = np.zeros((rods, edges, 2, edges, 2))
    every = np.arange(edges)
    blocks[:, every, :, every, :] = np.moveaxis(diagonal[..., None, None] * np.eye(2), 1, 0)
    product = beside[..., None, None] * np.swapaxes(turns[:, :-1], -1, -2) @ turns[:, 1:]
    blocks[:, every[:-1], :, every[1:], :] = np.moveaxis(product, 1, 0)
    blocks[:, every[1:], :, every[:-1], :] = np.moveaxis(np.swapaxes(product, -1, -2), 1, 0)
    return np.pad(blocks.reshape(rods, 2 * edges, 2 * edges), ((0, 0), (3, 0), (3, 0)))
