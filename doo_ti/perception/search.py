"""The steps of Algorithm 1: hypotheses grow by an edge, are relaxed under E_vis, and the best that differ are kept. The last
ones are relaxed until they converge, and rods traced along the detected lines join them.

    E_vis = E / B + ν Σ_c (E_proj^c + E_cover^c)                       (§IV-A); E_cover with evidence from both sides only

E_proj is what the rod's image is away from the detected line, a projected edge's mean distance to the nearest detected pixel
times its length, and E_cover what the line is away from the rod's image, px²: an edge that points at a camera costs nothing in
E_proj, so a rod may turn away from the thread. The rod's energy E is over the largest eigenvalue of B, in 1/mm: so ν is in
1/(mm px²), and its effect does not depend on the rod's stiffness.

Axes: A image sets, C cameras, N hypotheses of all sets, M sampled directions, R rods, F finalists of all sets, E edges.
"""

from dataclasses import dataclass, field

import numpy as np

from doo_ti.contact.surroundings import Surroundings
from doo_ti.perception.growth import Hypotheses, sampled_directions, select_hypotheses, suppress_similar
from doo_ti.perception.posterior import detected_places, vertex_sigma
from doo_ti.perception.traced import SAME_LENGTH, whole_rods
from doo_ti.relaxation.newton import Newton
from doo_ti.relaxation.relax import relax
from doo_ti.rod import frames
from doo_ti.rod.types import Clamp, Clamps, Configuration, Material, Solution, Status
from doo_ti.system.arguments import typed
from doo_ti.system.errors import InputError, require_whole
from doo_ti.vision.cameras import Rig
from doo_ti.vision.detection import thinned
from doo_ti.vision.distance_map import Coverage, DistanceMaps, coverage, nearest_place, of_thread
from doo_ti.vision.image_energy import Reprojection
from doo_ti.vision.score import Score, score

FAILED = Status.NOT_FINITE, Status.INFEASIBLE  # rods that have no shape; infeasible are those inside an obstacle
LOST = 1e30  # 1/mm: E_vis of a rod that failed while growing. Its start is kept if its set has no better hypothesis
CONVINCING, CLOSE_PX = 0.98, 0.5
"""A rod that grew is convincing if it explains this share of the detected line in every camera, and rod and line are this close
to each other on average. No rods are traced in a set that has one: tracing takes longer than the whole search."""
ASIDE = 0.5  # least length of an end's image, over that in another camera, that says where the thread ends
WIDE = np.radians(20.0)
"""Least angle between two cameras for that. Between closer ones a rod of a wrong length, or one folded along the line of sight,
explains the images as well."""


@typed
@dataclass(frozen=True)
class PerceptionOptions:
    """Options of Algorithm 1.

    nu                   ν, 1/(mm px²): weight of E_proj against energy over stiffness
    hypotheses           H: hypotheses kept per image set and step
    samples              M: directions tried for a new edge, evenly over the half sphere around the last one
    separation           rad: of sampled directions this near to each other only the best is grown
    children             largest number of edges grown from one hypothesis
    similar_distance     mm: hypotheses whose last vertices are this near …
    similar_angle        rad: … and whose last edges differ by less are the same; the better one is kept. Complete rods are the
                         same where their vertices are this near on average
    points               places along an edge where a map is sampled while growing
    cap                  px: distances to the detection saturate there
    growing_nu           ν while growing, smaller, so that rods can grow across a gap in the detection …
    growing_cap          … and the cap while growing
    growing_iterations   largest number of Newton's iterations, in f32, in each step of growth; the next step continues them
    finalists            hypotheses of each set, all different, that are relaxed until they converge
    pieces               pieces that each edge is cut into for that: the rod is finer than its marks, so that it can follow the
                         images' smooth lines
    final_points         places along an edge, all its pieces together, where a map is sampled for finalists
    runners_up           K: rods other than the best in the result
    unsupported          px: an edge further than this from the detection, on average, in every camera counts as unsupported
    evidence             "both": from the rod to the images and back, with hypotheses traced in them, where the maps' detections
                         are known; "rod": the paper's, E_proj of hypotheses that grew
    sigma_px             px: standard deviation of detected points, across the line …
    correlation_px       px: … and the length of line within which their errors are equal. Both only for the uncertainty, which
                         is larger where detected points turn out to be farther off
    """

    nu: float = 0.005
    hypotheses: int = 40
    samples: int = 160
    separation: float = np.radians(20.0).item()
    children: int = 5
    similar_distance: float = 1.0
    similar_angle: float = np.radians(15.0).item()
    points: int = 3
    cap: float = 40.0
    growing_nu: float = 0.0005
    growing_cap: float = 20.0
    growing_iterations: int = 6
    finalists: int = 8
    pieces: int = 4
    final_points: int = 8
    runners_up: int = 4
    unsupported: float = 3.0
    evidence: str = "both"
    sigma_px: float = 0.1
    correlation_px: float = 5.0

    def __post_init__(self) -> None:
        if self.evidence not in ("both", "rod"):
            raise InputError("PerceptionOptions", "evidence", f"{self.evidence!r} is unknown", "give both or rod")
        for name in ("nu", "separation", "similar_distance", "similar_angle", "cap", "growing_nu", "growing_cap", "unsupported",
                     "sigma_px", "correlation_px"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise InputError("PerceptionOptions", name, f"{getattr(self, name)}", "give a positive number")
        for name in ("hypotheses", "samples", "children", "points", "growing_iterations", "finalists", "pieces",
                     "final_points", "runners_up"):
            require_whole("PerceptionOptions", name, getattr(self, name), 0 if name == "runners_up" else 1)


@dataclass(frozen=True)
class Search:
    """The constants of a search."""

    maps: DistanceMaps
    rig: Rig  # the cameras of the maps
    point: np.ndarray  # (A, 3) mm, v⁰
    direction: np.ndarray  # (A, 3) unit vectors, e⁰
    rest_length: np.ndarray  # (E,) mm
    material: Material  # one Θ for all
    up: np.ndarray  # (3,) unit vector against gravity
    options: PerceptionOptions
    surroundings: Surroundings = Surroundings()  # what the rods may touch, the same for all
    first: np.ndarray = field(init=False)  # (A, 3, 3) frames of e⁰
    scale: float = field(init=False)  # the largest eigenvalue of B

    def __post_init__(self) -> None:
        object.__setattr__(self, "first", frames.some_frames(self.direction))
        object.__setattr__(self, "scale", float(np.linalg.eigvalsh(self.material.bend).max()))

    def initial_hypotheses(self) -> Hypotheses:
        """One hypothesis of one edge for each set: v⁰ and e⁰ as given, with an arbitrary roll."""
        count, first = len(self.first), frames.quaternion_from_matrix(self.first)
        return Hypotheses(np.arange(count), first[:, None], np.zeros(count))

    def grown(self, kept: Hypotheses) -> Hypotheses:
        """Each hypothesis with each of the edges of least Σ_c E_proj, by the images alone."""
        options = self.options
        length = self.rest_length[kept.quaternions.shape[1]]
        tip = self.vertices(kept)[:, -1]
        last = kept.quaternions[:, -1]
        local = sampled_directions(options.samples)
        around = local @ np.swapaxes(frames.matrix_from_quaternion(last), -1, -2)
        ends = tip[:, None] + length * around
        segments = np.stack([np.broadcast_to(tip[:, None], ends.shape), ends], axis=2).reshape(-1, 2, 3)
        found = self.errors(segments, np.repeat(kept.of_set, len(local)), options.points)
        error = found.camera_error.sum(axis=1).reshape(len(tip), -1)
        chosen = suppress_similar(error, local, options.separation, options.children)
        parent, place = np.nonzero(chosen >= 0)
        toward = around[parent, chosen[parent, place]]
        turn = frames.smallest_rotation(frames.tangent_from_quaternion(last[parent]), toward)
        new = frames.quaternion_product(turn, last[parent])
        quaternions = np.concatenate([kept.quaternions[parent], new[:, None]], axis=1)
        return Hypotheses(kept.of_set[parent], quaternions, kept.energy_vis[parent])

    def nearly_relaxed(self, grown: Hypotheses) -> Hypotheses:
        """A few iterations of F(Γ, E_vis, C) for all at once, in f32: rods that have not converged are continued in the next
        step of growth."""
        options = self.options
        start, clamps = self._held(grown, self.rest_length[: grown.quaternions.shape[1]])
        solver = Newton(max_iterations=options.growing_iterations, tolerance=0.1)
        solution = relax(start, self.material, clamps, solver, up=self.up, precision="f32 only",
                         external=self.seen(options.points, options.growing_nu, options.growing_cap),
                         external_index=grown.of_set, **self.surroundings.arguments)
        lost = np.isin(solution.status, FAILED)
        quaternions = np.where(lost[:, None, None], grown.quaternions, solution.configuration.quaternions)
        return Hypotheses(grown.of_set, quaternions, np.where(lost, LOST, solution.energy / self.scale))

    def relaxed(self, hypotheses: Hypotheses) -> tuple[Hypotheses, Solution]:
        """F(Γ, E_vis, C) until it converges, each edge cut into pieces."""
        pieces = self.options.pieces
        fine = Hypotheses(hypotheses.of_set, np.repeat(hypotheses.quaternions, pieces, axis=1), hypotheses.energy_vis)
        start, clamps = self._held(fine, np.repeat(self.rest_length / pieces, pieces))
        solution = relax(start, self.material, clamps, Newton(), up=self.up, precision="mixed",
                         external=self.seen(self.piece_points, self.options.nu, self.options.cap), external_index=fine.of_set,
                         **self.surroundings.arguments)
        energy = np.where(np.isin(solution.status, FAILED), np.inf, solution.energy / self.scale)
        return Hypotheses(fine.of_set, solution.configuration.quaternions, energy), solution

    def selected(self, grown: Hypotheses) -> np.ndarray:
        """Rows of the hypotheses to keep: the best that differ, at most H of each set."""
        options = self.options
        direction = frames.tangent_from_quaternion(grown.quaternions[:, -1])
        return select_hypotheses(grown.energy_vis, self.vertices(grown)[:, -1], direction, grown.of_set, options.hypotheses,
                                 options.similar_distance, options.similar_angle)

    def vertices(self, hypotheses: Hypotheses) -> np.ndarray:
        """(N, i + 1, 3) mm, of rods whose edges are whole."""
        edges = hypotheses.quaternions.shape[1]
        return Configuration(self.point[hypotheses.of_set], hypotheses.quaternions, self.rest_length[:edges]).vertices

    @property
    def both_ways(self) -> bool:
        """Whether what the images show counts as well: not with the paper's evidence, nor where detections are unknown."""
        return self.maps.detections is not None and self.options.evidence == "both"

    def reprojected(self, vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(A, C, E) px twice: mean distance to the detection along the image of each edge, and the length of that image."""
        sets, ends = vertices.shape[:2]
        segments = np.stack([vertices[:, :-1], vertices[:, 1:]], axis=2).reshape(-1, 2, 3)
        found = self.errors(segments, np.repeat(np.arange(sets), ends - 1), self.piece_points)
        error, length = (values.T.reshape(-1, sets, len(self.rest_length), self.options.pieces).sum(axis=-1).swapaxes(0, 1)
                         for values in (found.camera_error, self.image_length(segments)))
        return error / np.maximum(length, 1e-9), length

    def errors(self, rods: np.ndarray, of_set: np.ndarray | int, points: int) -> Score:
        """E_proj of ``rods`` (R, V, 3) mm of the sets ``of_set`` (R,), by so many ``points`` of each edge."""
        return score(rods, self.maps, of_set, self.rig, 1.0, points=points, cap=self.options.cap)

    def image_length(self, rods: np.ndarray) -> np.ndarray:
        """(R, C) px: lengths of the images of ``rods`` (R, V, 3) mm."""
        return np.linalg.norm(np.diff(self.rig.project(rods), axis=2), axis=-1).sum(axis=-1).T

    def sigma(self, rods: Configuration, start_covariance: np.ndarray | float = 0.0) -> np.ndarray:
        """(A, V) mm: uncertainty of the marks of one rod of each set, whose edges are cut into pieces, and whose start has the
        ``start_covariance`` (A, 3, 3) mm². Beyond the lines' end a rod may be longer than the thread, or hidden."""
        detections, marks = self.maps.detections, rods.vertices[:, :: self.options.pieces]
        noise = self.options.sigma_px, self.options.correlation_px
        if detections is None:
            return vertex_sigma(self.rig, marks, *noise, start_covariance=start_covariance)
        detected, scatter = detected_places(self.rig, rods.vertices, self.options.pieces, detections)
        beyond = np.maximum(np.insert(np.cumsum(self.rest_length), 0, 0.0) - self.shown_length(rods)[:, None], 0.0)
        return np.hypot(vertex_sigma(self.rig, marks, *noise, scatter, detected, start_covariance), beyond / np.sqrt(3))

    def shown_length(self, rods: Configuration) -> np.ndarray:
        """(A,) mm from the start of one rod of each set to where the lines along it end, in the camera where that is farthest,
        of those that do not look along the rod's end; NaN where detections are unknown."""
        images = np.nan_to_num(self.rig.project(rods.vertices), nan=-1e6)
        if self.maps.detections is None:
            return np.full(images.shape[1], np.nan)
        last = np.zeros(images.shape[:2])
        for c, row in np.ndindex(last.shape):
            place, far = nearest_place(thinned(of_thread(self.maps.detections[row][c]))[0], images[c, row])
            last[c, row] = place[~far].max(initial=0.0)
        end = np.linalg.norm(images[:, :, -1] - images[:, :, -2], axis=-1)
        edges, lengths = np.where(end >= ASIDE * end.max(axis=0), last, 0.0).max(axis=0), np.atleast_2d(rods.rest_length)
        arcs = np.broadcast_to(np.pad(np.cumsum(lengths, axis=1), ((0, 0), (1, 0))), (len(edges), images.shape[2]))
        return np.array([np.interp(place, np.arange(len(arc)), arc) for place, arc in zip(edges, arcs, strict=True)])

    def seen(self, points: int, nu: float, cap: float) -> Reprojection:
        """ν Σ E_proj in the units of the rod's energy."""
        return Reprojection(self.maps, self.rig, nu * self.scale, points, cap)

    @property
    def piece_points(self) -> int:
        """Places along a piece of an edge where a map is sampled."""
        return -(-self.options.final_points // self.options.pieces)

    def _held(self, hypotheses: Hypotheses, rest_length: np.ndarray) -> tuple[Configuration, Clamps]:
        """C of Alg. 1: the start is held, the far end is free."""
        point, first = self.point[hypotheses.of_set], self.first[hypotheses.of_set]
        clamps = Clamps(Clamp.TANGENT, Clamp.FREE, point, point, first, first)
        return Configuration(point, hypotheses.quaternions, rest_length), clamps


def evidence(rig: Rig, maps: DistanceMaps, rods: Configuration, of_set: np.ndarray, material: Material, up: np.ndarray,
             options: PerceptionOptions, points: int) -> tuple[np.ndarray, Coverage]:
    """(R,) E_vis in 1/mm, infinite where it is not finite, and what rods of the sets ``of_set`` (R,) explain. A material that
    is not round counts as a round one as stiff.

    points  places along an edge where a map is sampled
    """
    stiffness = float(np.linalg.eigvalsh(material.bend).max())
    round_one = Material(stiffness, stiffness, material.weight[0])
    one_way = score(rods.vertices, maps, of_set, rig, options.nu * stiffness, round_one, points=points, cap=options.cap, up=up)
    found = coverage(rig, rods.vertices, of_set, maps.detections, options.cap)
    energy = one_way.total / stiffness + options.nu * found.error.sum(axis=1)
    return np.where(np.isfinite(energy), energy, np.inf), found


# --- the last hypotheses ------------------------------------------------------------------------------------------------------

@dataclass(frozen=True)
class Finalists:
    """F rods on the fine mesh."""

    of_set: np.ndarray  # (F,) image set, in increasing order
    configuration: Configuration  # the rods
    energy_vis: np.ndarray  # (F,) 1/mm; infinite for rods that failed
    status: np.ndarray  # (F,) how their relaxation ended
    certified: np.ndarray  # (F,) bool: at a minimum of the energy that they were relaxed under
    coverage: np.ndarray  # (F, C) share of the detected line that is explained; NaN where the detections are not known
    line: np.ndarray  # (F, C) px of detected line
    thread: np.ndarray  # (F,) mm: length of the thread that a traced rod follows; NaN of others


def finalists(search: Search, grown: Hypotheses) -> Finalists:
    """The rods that ``grown`` become when they are relaxed and, in sets where none of these is convincing, traced rods."""
    own, found = explained(search, *search.relaxed(grown))
    if found is None:
        return own
    convincing = own.certified & (found.share >= CONVINCING).all(axis=1) & (found.error <= CLOSE_PX * found.line).all(axis=1)
    convincing &= _clearly_seen(search, own.configuration, own.of_set)
    doubtful = np.setdiff1d(np.arange(len(search.point)), own.of_set[convincing])
    return own if not len(doubtful) else _with_traced(search, own, doubtful)


def explained(search: Search, hypotheses: Hypotheses, solution: Solution) -> tuple[Finalists, Coverage | None]:
    """The relaxed ``hypotheses``, and what of the detected lines they explain; None where that does not count."""
    of_set, energy, options = hypotheses.of_set, hypotheses.energy_vis, search.options
    certified = (solution.status == Status.CONVERGED) & solution.stable
    unknown = np.full((len(of_set), len(search.rig.cameras)), np.nan)
    if not search.both_ways:
        return Finalists(of_set, solution.configuration, energy, solution.status, certified, unknown, unknown,
                         unknown[:, 0]), None
    found = coverage(search.rig, solution.configuration.vertices, of_set, search.maps.detections, options.cap)
    return Finalists(of_set, solution.configuration, energy + options.nu * found.error.sum(axis=1), solution.status, certified,
                     found.share, found.line, unknown[:, 0]), found


def _clearly_seen(search: Search, rods: Configuration, of_set: np.ndarray) -> np.ndarray:
    """(R,) bool: every camera sees all of the rod near the detection, and two of them from directions that differ by WIDE."""
    found = search.errors(rods.vertices, of_set, search.piece_points)
    near = found.camera_error <= CLOSE_PX * search.image_length(rods.vertices)
    sight = frames.unit_vectors(np.stack([rods.vertices.mean(axis=1) - camera.centre for camera in search.rig.cameras], axis=1))
    angle = np.arccos(np.clip(np.einsum("rci,rdi->rcd", sight, sight).min(axis=(1, 2)), -1.0, 1.0))
    return (near & (found.unseen == 0)).all(axis=1) & (angle >= WIDE)


def _with_traced(search: Search, grown: Finalists, sets: np.ndarray) -> Finalists:
    """``grown``, and rods traced in the image sets ``sets``."""
    fine = np.repeat(search.rest_length / search.options.pieces, search.options.pieces)
    length, shares = float(fine.sum()), fine / fine.sum()
    detections = [search.maps.detections[row] for row in sets]
    tracing, whole = whole_rods(search.rig, detections, search.point[sets], search.direction[sets], shares, search.material,
                                search.up)
    if whole is None:
        return grown
    together = np.abs(whole.length / length - 1) < SAME_LENGTH
    cut = whole.cut(shares, np.where(together, 1.0, length / whole.length), np.full(len(together), length))
    solution = tracing.relaxed(cut, together).solution
    of_set, rods = sets[tracing.of_set], solution.configuration
    looked = search.material, search.up, search.options, search.piece_points
    energy, found = evidence(search.rig, search.maps, rods, of_set, *looked)
    if not together.all():  # a rod shorter than the thread, or longer, is as good as the whole thread that it is part of
        part = np.flatnonzero(~together)
        energy[part], _ = evidence(search.rig, search.maps, whole.solution.configuration.take(part), of_set[part], *looked)
    parts = grown, Finalists(of_set, Configuration(rods.start, rods.quaternions, fine), energy, solution.status,
                             (solution.status == Status.CONVERGED) & solution.stable, found.share, found.line, whole.length)
    order = np.argsort(np.concatenate([part.of_set for part in parts]), kind="stable")
    joined = {name: np.concatenate([getattr(part, name) for part in parts])[order] for name in Finalists.__dataclass_fields__
              if name != "configuration"}
    return Finalists(configuration=Configuration.concatenate([part.configuration for part in parts]).take(order), **joined)


def left_over(thread: np.ndarray, left: np.ndarray, image_length: np.ndarray, length: float) -> np.ndarray:
    """(A,) mm of thread that rods of ``length`` mm do not explain, of a ``thread`` (A,) mm long. Where that is not known: px of
    line, ``left`` (A, C), at the scale of the rod's image, (A, C) px long, in the camera where that is most."""
    unexplained = left / np.maximum(image_length, 1e-9) * length
    return np.where(np.isnan(thread), unexplained.max(axis=1), np.maximum(thread - length, 0.0))
