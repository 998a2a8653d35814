"""The items of ``tools/studies/reproduce.py``; specimens and landscapes that several of them need are computed once."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cache

import numpy as np

from doo_ti import Descent, Landscape, Material, Newton, observation_clamps, relax, start_configuration
from doo_ti.io.scene import OBJECTIVES
from tools.studies.replication import tables
from tools.studies.replication.images import Seen, loops, perceived, recovery
from tools.studies.replication.landscapes import figure_1, figure_3, figure_4, figure_5, landscape, learned
from tools.studies.replication.settings import PACKAGE, SETTINGS, Setting, Size, entry
from tools.studies.replication.specimens import LABORATORIES, SUTURES, Laboratory, calibrated, forward, made, scene, specimen
from tools.studies.replication.twist import Errors, figure_7, percent, twist_errors

SAME_MM, MOST = 0.02, 0.98
Held = dict[str, list[bool]]


@dataclass(frozen=True)
class Found:
    """Results of an item: by setting the criteria that hold, specimen by specimen, and lines of Markdown."""

    held: dict[str, Held] = field(default_factory=dict)
    lines: list[str] = field(default_factory=list)


class Study:
    """What is measured, at one size."""

    def __init__(self, size: Size, progress: Callable[[str], None] = lambda text: None):
        self.size, self.progress = size, progress
        self.specimen, self.made, self.landscape, self.seen, self.harder = map(
            cache, (specimen, made, self._landscape, self._seen, self._harder))

    def _landscape(self, name: str, number: int, setting: Setting, objective: str) -> Landscape:
        self.progress(f"{setting.name}: {'Eq. 2' if objective == 'static' else 'Eq. 3'}, {name} {number}")
        return landscape(self.specimen(name, number), setting, objective)

    def _harder(self, name: str, number: int, laboratory: Laboratory, objective: str):
        if laboratory == LABORATORIES[0].labelled:
            return self.landscape(name, number, PACKAGE, objective)
        return landscape(self.made(name, number, laboratory), PACKAGE, objective)

    def _seen(self, name: str, number: int, setting: Setting) -> Seen:
        self.progress(f"{setting.name}: images, {name} {number}")
        theta = self.theta(name, number, setting, by_distance=False)
        return perceived(self.specimen(name, number), setting, theta, self.size.images[setting.name][1])

    def theta(self, name: str, number: int, setting: Setting, by_distance: bool) -> Material:
        return learned(self.landscape(name, number, setting, "static"), by_distance)

    def all_static(self, setting: Setting) -> list[dict[str, Landscape]]:
        return [{name: self.landscape(name, number, setting, "static") for name in SUTURES}
                for number in range(self.size.specimens)]

    def both(self, name: str, count: int, setting: Setting) -> list[tuple[Landscape, Landscape]]:
        """Those of Eq. 2 and of Eq. 3 of ``count`` specimens."""
        return [tuple(self.landscape(name, number, setting, objective) for objective in OBJECTIVES) for number in range(count)]

    def all_seen(self, setting: Setting) -> list[dict[str, Seen]]:
        return [{name: self.seen(name, number, setting) for name in SUTURES}
                for number in range(self.size.images[setting.name][0])]

    def scheme(self) -> Found:
        """Newton beside the paper's own scheme, at the learned Θ, from the same starts."""
        same, lines = [], []
        for name in SUTURES:
            self.progress(f"Descent, {name}")
            whole = self.specimen(name, 0).observations
            some = whole.take(np.linspace(0, whole.count - 1, self.size.descent).round().astype(int))
            clamps = observation_clamps(some)
            start, theta = start_configuration(some, clamps), self.theta(name, 0, PACKAGE, False)
            slow = relax(start, theta, clamps, Descent(tolerance=1e-5, max_iterations=100_000))
            fast = relax(start, theta, clamps, Newton())
            apart = np.linalg.norm(slow.configuration.vertices - fast.configuration.vertices, axis=-1).mean(axis=1)
            same.append(apart <= SAME_MM)
            lines.append(f"- {name}: {same[-1].sum()} of {len(apart)} rods in the same minimum; iterations, median: "
                         f"{np.median(slow.iterations):.0f} of Descent, {np.median(fast.iterations):.0f} of Newton")
        held = {"same": [np.concatenate(same).mean() >= MOST]}
        return Found({setting.name: held for setting in SETTINGS}, lines)

    def table(self, paper: tuple, make: Callable[[Setting], tables.TableRuns]) -> Found:
        runs = {setting.name: make(setting) for setting in SETTINGS}
        return Found({name: one.held for name, one in runs.items()}, tables.beside(paper, list(runs.values())))

    def table_1(self) -> Found:
        return self.table(tables.PAPER_I, lambda setting: tables.table_1(self.all_static(setting)))

    def table_2(self) -> Found:
        return self.table(tables.PAPER_II, lambda setting: tables.table_2(self.all_static(setting)))

    def table_3(self) -> Found:
        return self.table(tables.PAPER_III, lambda setting: tables.table_3(self.both("vicryl", self.size.specimens, setting)))

    def figure_1(self) -> Found:
        held, lines = figure_1()
        return Found({setting.name: held for setting in SETTINGS}, lines)

    def by_setting(self, make: Callable[[Setting], tuple[Held, list[str]]]) -> Found:
        held, lines = {}, []
        for setting in SETTINGS:
            held[setting.name], more = make(setting)
            lines += [f"{setting.name.capitalize()}:", "", *more, ""]
        return Found(held, lines)

    def figure_3(self) -> Found:
        return self.by_setting(lambda setting: figure_3(self.all_static(setting)))

    def figure_4(self) -> Found:
        return self.by_setting(lambda setting: figure_4([one["vicryl"] for one in self.all_static(setting)]))

    def figure_5(self) -> Found:
        return self.by_setting(lambda setting: figure_5(self.both("ribbon", self.size.ribbons, setting)))

    def figure_6(self) -> Found:
        for name in SUTURES:
            scene(f"loops_{name}")  # a run that leaves some out fails as well where one is missing

        def one(setting: Setting):
            threads, most = self.size.loops[setting.name]
            self.progress(f"{setting.name}: loops")
            return loops({name: self.theta(name, 0, setting, False) for name in SUTURES[:threads]}, setting, most)
        return self.by_setting(one)

    def perception(self) -> Found:
        return self.by_setting(lambda setting: recovery(self.all_seen(setting)))

    def figure_7(self) -> Found:
        return self.by_setting(lambda setting: figure_7(
            [self._twist(number, seen, setting) for number, seen in enumerate(self.all_seen(setting))]))

    def _twist(self, number: int, seen: dict[str, Seen], setting: Setting) -> Errors:
        self.progress(f"{setting.name}: Eq. 4, specimens {number}")
        theta = {name: self.theta(name, number, setting, setting.by_distance) for name in SUTURES}
        return twist_errors({name: self.specimen(name, number) for name in SUTURES}, seen, theta, self.size.trials, number)

    def laboratories(self) -> Found:
        """Table III and Fig. 7 in laboratories less close to the model; Θ of Fig. 7 by end distance, as the paper takes it."""
        lines = ["| laboratory | Eq. 3 under Θ of Eq. 2, mm | gain of Θ of Eq. 3, mm | *dynamic* holds | Fig. 7, D = 1 | D = 6 "
                 "| ambiguous |", "|---" * 7 + "|"]
        for laboratory in LABORATORIES:
            runs, errors = self._harder_table(laboratory), self._harder_twist(laboratory)
            gained, error, before = tables.gain(runs)
            lines.append(f"| {laboratory.name} | {before:.2f} | {gained:+.3f} ± {error:.3f} | {sum(runs.held['dynamic'])} of "
                         f"{len(runs.held['dynamic'])} | {percent([one.success(1) for one in errors])} "
                         f"| {percent([one.success(6) for one in errors])} | {percent([one.ambiguous for one in errors])} |")
        return Found({}, [*lines, "", *self._forward()])

    def _harder_table(self, laboratory: Laboratory) -> tables.TableRuns:
        pairs = []
        for number in range(self.size.harder[0]):
            self.progress(f"{laboratory.name}: vicryl {number}")
            pairs.append(tuple(self.harder("vicryl", number, laboratory.labelled, objective) for objective in OBJECTIVES))
        return tables.table_3(pairs)

    def _harder_twist(self, laboratory: Laboratory) -> list[Errors]:
        found, (specimens, sets, trials) = [], self.size.harder
        for number in range(specimens):
            self.progress(f"{laboratory.name}: Fig. 7, specimens {number}")
            rods = {name: self.made(name, number, laboratory.labelled) for name in SUTURES}
            static = {name: self.harder(name, number, laboratory.labelled, "static") for name in SUTURES}
            rig = None if laboratory.calibrated else calibrated(number)
            seen = {name: perceived(one, PACKAGE, learned(static[name], False), sets, laboratory.look, rig)
                    for name, one in rods.items()}
            theta = {name: learned(one, True) for name, one in static.items()}
            found.append(twist_errors(rods, seen, theta, trials, number))
        return found

    def _forward(self) -> Iterator[str]:
        """Rods carried only in the recorded direction."""
        yield "Carried only in the recorded direction, tested on Eq. 3, all end distances, leave-one-out:"
        yield ""
        for name in SUTURES:
            gained = []
            for number in range(self.size.harder[0]):
                rods = self.specimen(name, number)
                both = [self.landscape(name, number, PACKAGE, "static"), landscape(rods, PACKAGE, "dynamic", forward(rods))]
                (_, static), (_, dynamic) = tables.scored(both, ("objective",)).mean
                gained.append(static - dynamic)
            yield f"- {name}: Θ of Eq. 3 gains {entry(gained, 3)} mm"


ITEMS: dict[str, Callable[[Study], Found]] = {
    "F (§III-D)": Study.scheme, "Table I": Study.table_1, "Table II": Study.table_2, "Table III": Study.table_3,
    "Fig. 1": Study.figure_1, "Fig. 3": Study.figure_3, "Fig. 4": Study.figure_4, "Fig. 5": Study.figure_5,
    "Fig. 6": Study.figure_6, "Perception": Study.perception, "Fig. 7": Study.figure_7,
    "Harder laboratories": Study.laboratories,
}
