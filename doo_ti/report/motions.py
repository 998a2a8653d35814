"""Pictures of rods in motion: beside what was recorded, with errors over time, as animations; of rods whose clamps move
(§III-D), and of rods brought to a target (§VI).

Axes: R rods, T frames or steps, V vertices.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from PIL import Image

from doo_ti.contact.obstacles import Obstacle
from doo_ti.contact.surroundings import Moving
from doo_ti.report import canvas
from doo_ti.report.contact import FAINT, Touched
from doo_ti.system.arguments import counted
from doo_ti.system.files import write_whole

MOST_RODS = 6  # in a picture, those of the largest, the median and the smallest errors
STILLS = 9  # positions of a rod in a picture
ANIMATED, FRAMES_PER_SECOND, MOST_FRAMES = 8, 25, 250
VIEWS = 36  # directions from which a motion may be seen
LEAST_MOTION, WORTH_TURNING = 1e-4, 3.0
"""Of the rods' size squared, below which motion is not looked at; and how much more has to be seen to turn the view."""
RECORDED, PREDICTED = "#9a9a9a", "#c2410c"


def _view(rods: np.ndarray, up: np.ndarray) -> tuple[np.ndarray, str]:
    """(2, 3) directions of a picture of (R, T, V, 3) rods, and from where that is."""
    places = rods.reshape(len(rods), -1, 3)
    places = places[np.isfinite(places).any(axis=(1, 2))] if np.isfinite(places).any() else np.zeros((1, 1, 3))
    upward, view = canvas.facing(places, up)
    return _turned(canvas.upright_basis(places, upward), rods)[[0, 2]], view


def _turned(basis: np.ndarray, rods: np.ndarray) -> np.ndarray:
    """The ``basis`` (3, 3) of a view turned about its upward axis so that both the shapes of (R, T, V, 3) rods and their motion
    are seen."""
    flat = rods @ basis[:2].T
    shape, motion = (np.einsum("rtvi,rtvj->ij", part, part) for part in (canvas.deviations(flat, axis) for axis in (2, 1)))
    if np.trace(motion) < LEAST_MOTION * np.trace(shape):
        return basis
    angle = np.linspace(0.0, np.pi, VIEWS, endpoint=False)
    across = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    seen = np.einsum("ai,ij,aj->a", across, shape, across) * np.einsum("ai,ij,aj->a", across, motion, across)
    best = int(seen.argmax())
    if seen[best] < WORTH_TURNING * seen[0]:
        return basis
    right = across[best] @ basis[:2]
    return np.stack([right, np.cross(basis[2], right), basis[2]])


def chosen(positions: np.ndarray, recorded: np.ndarray | None, most: int) -> np.ndarray:
    """Rows of the rods that are shown: the first, or spread over the order of their errors."""
    count = len(positions)
    if recorded is None:
        return np.arange(min(count, most))
    order = np.argsort(np.abs(positions - recorded).mean(axis=(1, 2, 3)), kind="stable")  # NaN comes last
    return order[np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int))]


def save_rollout(path: Path, name: str, names: list[str], positions: np.ndarray, recorded: np.ndarray | None, rate: float,
                 up: np.ndarray, energies: dict[str, np.ndarray] | None = None, touched: Touched | None = None) -> None:
    """A picture of (R, T, V, 3) rods: some of them at several instants; where they were ``recorded`` that as well, and the
    error of all over time; where ``energies`` (R, T) by name are given, those of the first rod that is shown; obstacles, and
    contact forces at the last instant, where rods have ``touched`` any."""
    rows = chosen(positions, recorded, MOST_RODS)
    columns = min(3, len(rows))
    lines = -(-len(rows) // columns)
    plots = (recorded is not None) + (energies is not None)
    figure = canvas.new_figure((max(5.0, 4.2 * columns), 3.4 * lines + max(0.4, 2.6 * plots)))
    heights = [1.0] * lines + [0.75] * plots
    grid = figure.add_gridspec(len(heights), columns, height_ratios=heights)
    shown = positions[rows]
    axes, view = _view(shown if recorded is None else recorded[rows], up)
    frames = np.linspace(0, positions.shape[1] - 1, min(STILLS, positions.shape[1])).round().astype(int)
    for k, row in enumerate(rows):
        plot = figure.add_subplot(grid[k // columns, k % columns])
        _draw_stills(plot, axes, positions[row, frames], None if recorded is None else recorded[row, frames])
        if touched is not None:
            plot.update_datalim(touched.tips([row], frames[-1]) @ axes.T)
            plot.autoscale_view()
            for frame in frames[:-1]:
                touched.draw_obstacles(plot, row, axes, frame, Moving, FAINT)
            touched.draw(plot, row, axes, frames[-1])
        title = names[row]
        if recorded is not None:
            title = f"recording {title}: {np.abs(positions[row, 2:] - recorded[row, 2:]).mean():.1f} mm"
        plot.set_title(canvas.literal(title), fontsize=9)
        if not k:
            plot.legend(fontsize=8, frameon=False)
    time = np.arange(positions.shape[1]) / rate
    if recorded is not None:
        plot, error = figure.add_subplot(grid[lines, :]), np.abs(positions - recorded).mean(axis=(2, 3))  # (R, T) of all rods
        plot.plot(time, error.T, color=PREDICTED, lw=0.5, alpha=0.35)
        known = np.isfinite(error).any(axis=0)
        plot.plot(time[known], np.nanmedian(error[:, known], axis=0), color="black", lw=1.6, label="median")
        most = max(1.0, 1.1 * np.quantile(error[np.isfinite(error)], 0.99) if known.any() else 0.0)
        plot.set(ylim=(0, most), xlabel="time [s]", ylabel="mean |difference| [mm]")
        plot.legend(fontsize=8, frameon=False)
    if energies is not None:
        first = {name: value[rows[0]] for name, value in energies.items()}
        _draw_energies(figure.add_subplot(grid[-1, :]), time, first, names[rows[0]])
    last = (positions.shape[1] - 1) / rate
    title = f"{name}: {len(frames)} of {positions.shape[1]} frames from 0 to {last:.3g} s, seen {view}"
    canvas.save_figure(figure, path, title if touched is None else f"{title}\n{touched.legend_at_end}", 8)


def _draw_stills(plot, axes: np.ndarray, positions: np.ndarray, recorded: np.ndarray | None) -> None:
    """A rod at several instants, (N, V, 3) each, seen along ``axes`` (2, 3), later ones darker."""
    for n, rod in enumerate(positions):
        fade, last = 0.25 + 0.75 * (n + 1) / len(positions), n == len(positions) - 1
        if recorded is not None:
            plot.plot(*(recorded[n] @ axes.T).T, color=RECORDED, lw=2.2, alpha=fade, label="recorded" if last else None)
        plot.plot(*(rod @ axes.T).T, color=PREDICTED, lw=1.1, alpha=fade, label="simulated" if last else None)
    plot.set_aspect("equal", adjustable="datalim")
    plot.set_xlabel(f"{canvas.direction(axes[0])} [mm]", fontsize=8)
    plot.set_ylabel(f"{canvas.direction(axes[1])} [mm]", fontsize=8)
    plot.tick_params(labelsize=8)


def _draw_energies(plot, time: np.ndarray, energies: dict[str, np.ndarray], name: str) -> None:
    """Energies (T,) of one rod by their names; what has flown, which only adds up, dashed."""
    for label, value in energies.items():
        plot.plot(time, value, lw=1.4, label=label, color="black" if label == "sum" else None,
                  ls="--" if label in ("dissipated", "work", "unaccounted") else "-")
    plot.set_xlabel("time [s]")
    plot.set_ylabel(canvas.literal(f"energy of {name} [mm²]"), fontsize=9)
    plot.legend(fontsize=8, frameon=False, ncols=4, loc="lower center", bbox_to_anchor=(0.5, 1.0), handlelength=1.6,
                columnspacing=1.2)


def save_animation(path: Path, name: str, names: list[str], positions: np.ndarray, recorded: np.ndarray | None, rate: float,
                   up: np.ndarray, touched: Touched | None = None) -> None:
    """A GIF or WebP of some of the (R, T, V, 3) rods moving side by side, in real time where that is not too long; with the
    obstacles and the contact forces of the moment where rods have ``touched`` any."""
    rows = chosen(positions, recorded, ANIMATED)
    axes, _ = _view(positions[rows], up)
    every = max(1, round(rate / FRAMES_PER_SECOND), -(-positions.shape[1] // MOST_FRAMES))
    frames = range(0, positions.shape[1], every)
    flat = positions[rows] @ axes.T
    limits = canvas.limits_around(flat, 0.54, 0.2)
    size = np.ptp(limits, axis=-1)
    columns = min(4, len(rows))
    lines = -(-len(rows) // columns)
    width = 2.6 if columns > 1 else 3.6
    head = 0.3 if touched is None else 0.5
    figure = canvas.new_figure((width * columns, min(width * size[1] / size[0] + 0.3, 4.0) * lines + head), 80)
    curves, momentary = [], []  # lines with their places at all frames, and what is drawn for one
    for k in range(len(rows)):
        plot = figure.add_subplot(lines, columns, k + 1)
        plot.set(xlim=limits[0], ylim=limits[1], aspect="equal", xticks=[], yticks=[])
        plot.set_title(canvas.literal(names[rows[k]]), fontsize=9)
        if touched is not None:
            touched.draw_obstacles(plot, rows[k], axes, 0, Obstacle)
        if recorded is not None:
            curves += [(line, recorded[rows[k]] @ axes.T) for line in plot.plot([], [], color=RECORDED, lw=4)]
        curves += [(line, flat[k]) for line in plot.plot([], [], color=PREDICTED, lw=1.8)]
    figure.suptitle(canvas.literal(name) + ("" if touched is None else f"\nblue: {touched.legend}"), fontsize=10)
    canvas.fit_titles(figure)
    images = []
    for frame in frames:
        for drawn in momentary:
            drawn.remove()
        momentary = [] if touched is None else [
            drawn for plot, row in zip(figure.axes, rows, strict=True)
            for drawn in (*touched.draw_obstacles(plot, row, axes, frame, Moving),
                          *touched.draw_forces(plot, row, axes, frame))]
        for line, places in curves:
            line.set_data(*places[frame].T)
        figure.canvas.draw()
        images.append(Image.fromarray(np.asarray(figure.canvas.buffer_rgba())[..., :3]))
    if path.suffix == ".gif":
        images = [image.quantize(32, dither=Image.Dither.NONE) for image in images]
    write_whole(path, lambda file: images[0].save(file, path.suffix[1:], save_all=True, append_images=images[1:],
                                                  duration=round(1000 * every / rate), loop=0))


START, TARGET, END = "#9a9a9a", "#2f7bff", "#c2410c"


def servo_picture(path_or_buffer, name: str, start: np.ndarray, end: np.ndarray, target: np.ndarray, distance: np.ndarray,
                  reached: float, up: np.ndarray) -> None:
    """Write a PNG: the true rod (V, 3) at the ``start`` and at the ``end`` and its ``target``, NaN where nothing is asked, from
    the front and from above; and its ``distance`` (T, 2) mm to the target after each step, true and as estimated."""
    figure = canvas.new_figure((9.0, 5.6))
    grid = figure.add_gridspec(2, 2, width_ratios=[1.1, 1.0])
    basis = canvas.upright_basis(np.stack([start, end]), up)
    for row, (view, label) in enumerate(((basis[[0, 2]], "from the front"), (basis[:2], "from above"))):
        axes = figure.add_subplot(grid[row, 0])
        axes.plot(*(start @ view.T).T, color=START, lw=1.6, label="start")
        axes.plot(*(target @ view.T).T, color=TARGET, lw=4.5, alpha=0.5, marker="o", ms=3, label="target")
        axes.plot(*(end @ view.T).T, color=END, lw=1.4, label="end")
        axes.set_aspect("equal", adjustable="datalim")
        axes.set_title(f"{label}: {canvas.direction(view[1])} over {canvas.direction(view[0])} [mm]", fontsize=9)
        axes.tick_params(labelsize=8)
        axes.grid(alpha=0.2)
        if not row:
            axes.legend(fontsize=8, frameon=False)
    axes = figure.add_subplot(grid[:, 1])
    steps = np.arange(1, len(distance) + 1)
    axes.plot(steps, distance[:, 0], color=END, lw=1.6, label="true")
    axes.plot(steps, distance[:, 1], color="black", lw=1.0, ls="--", label="as estimated")
    axes.axhline(reached, color=TARGET, lw=0.8, label="reached")
    axes.set(yscale="log", xlabel="step")
    axes.set_title("distance to the target [mm], root mean square", fontsize=9)
    axes.legend(fontsize=8, frameon=False)
    axes.grid(alpha=0.2, which="both")
    canvas.save_figure(figure, path_or_buffer, f"{name}: {len(distance)} steps", 11)


MOST_DRAWN, COLUMNS = 12, 4
MOMENTS = 9  # of each rod, evenly chosen
JUMP = "#ff2e63"


@dataclass(frozen=True)
class MovingRods:
    """T moments of R rods whose clamps move.

    time      (T,) s
    vertices  (T, R, V, 3) mm, NaN where a rod has no configuration
    names     R of them
    jumps     (T, R) jumps to another branch since the moment before
    sound     (T, R) bool: certified minima so far
    up        (3,) direction against gravity
    grippers  (T, R, lines, points, 3) mm: lines that show how the ends are held; None: not drawn
    marks     (R, V, 3) mm: what was observed of the rods at the start, NaN where missing; None where nothing was
    touched   obstacles around the rods, and the forces of contact; None without obstacles
    """

    time: np.ndarray
    vertices: np.ndarray
    names: list[str]
    jumps: np.ndarray
    sound: np.ndarray
    up: np.ndarray = (0.0, 0.0, 1.0)
    grippers: np.ndarray | None = None
    marks: np.ndarray | None = None
    touched: Touched | None = None

    @property
    def basis(self) -> np.ndarray:
        """(3, 3) rows right, into the picture, and up."""
        return canvas.upright_basis(self.vertices.reshape(-1, *self.vertices.shape[2:]), self.up)


def motions_picture(path_or_buffer, rods: MovingRods, *, title: str) -> None:
    """Write the motions as a PNG, at most the first ``MOST_DRAWN``, ``COLUMNS`` beside each other: each from the front and
    below that from above. Early moments are dark; the shapes before a jump, dashed, and after it are thick and red."""
    shown, time = min(len(rods.names), MOST_DRAWN), rods.time
    scale = ScalarMappable(Normalize(time[0], time[-1]), colormaps["viridis"])
    vertices, jumps = rods.vertices[:, :shown], rods.jumps[:, :shown]
    moments = np.unique(np.linspace(0, len(time) - 1, MOMENTS).round().astype(int))
    views = [rods.basis[[0, 2]], rods.basis[:2]]
    places = vertices.reshape(-1, 3)
    if rods.touched is not None:
        places = np.concatenate([places, rods.touched.tips(range(shown), -1)])
    limits = [canvas.limits_around(places @ view.T, 0.55, 0.18) for view in views]
    heights = [np.ptp(limit[1]) / np.ptp(limit[0]) for limit in limits]
    columns, blocks = min(shown, COLUMNS), -(-shown // COLUMNS)
    figure = canvas.new_figure((3.4 * columns + 0.8, blocks * (3.2 * sum(heights) + 0.8) + 0.8))
    panels = figure.subplots(2 * blocks, columns, squeeze=False, height_ratios=blocks * heights)
    for rod in range(columns * blocks):
        block, column = divmod(rod, columns)
        for row, (view, label) in enumerate(zip(views, ("from the front", "from above"), strict=True)):
            axes = panels[2 * block + row, column]
            if rod >= shown:
                axes.set_axis_off()
                continue
            axes.set(xlim=limits[row][0], ylim=limits[row][1], aspect="equal")
            flat = vertices[:, rod] @ view.T
            for moment in moments:
                axes.plot(*flat[moment].T, color=scale.to_rgba(time[moment]), linewidth=1.4)
            for moment in np.flatnonzero(jumps[:, rod]):
                axes.plot(*flat[max(moment - 1, 0)].T, "--", color=JUMP, linewidth=1.8)
                axes.plot(*flat[moment].T, color=JUMP, linewidth=1.8)
            if rods.touched is not None:
                rods.touched.draw(axes, rod, view, len(time) - 1)
            axes.grid(alpha=0.2)
            if column == 0:
                axes.set_ylabel(f"{label}\n{canvas.direction(view[1])} [mm]", fontsize=9)
            if row == 0:
                count = int(jumps[:, rod].sum())
                axes.set_title(canvas.literal(rods.names[rod]) + f": {counted(count, 'jump')}" * (count > 0), fontsize=10)
    figure.supxlabel(f"{canvas.direction(views[0][0])} [mm]", fontsize=10)
    figure.colorbar(scale, ax=list(panels.ravel()), pad=0.01, aspect=40).set_label("time [s]", fontsize=10)
    more = f" ({len(rods.names) - shown} more are not drawn)" if len(rods.names) > shown else ""
    red = "\nred: before a jump (dashed) and after it" if jumps.any() else ""
    blue = "" if rods.touched is None else f"\n{rods.touched.legend_at_end}"
    canvas.save_figure(figure, path_or_buffer, f"{title}{more}{red}{blue}")
