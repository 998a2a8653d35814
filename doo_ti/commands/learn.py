"""Θ from finished sweeps (§III-E), and how well it fits other observations (§V-B, §V-C)."""

from argparse import Namespace
from pathlib import Path
from shutil import get_terminal_size

from doo_ti.commands import options as given
from doo_ti.commands.results import plain, report, run_lines, save_json
from doo_ti.learning.cross_validation import FACTORS, Scores, check_comparable, cross_validate, partition, usual_factors
from doo_ti.learning.landscape import Landscape, read_landscape
from doo_ti.learning.score_table import caption, comma_separated, entries, file_stem, markdown, text
from doo_ti.system.errors import InputError
from doo_ti.system.files import write_text
from doo_ti.system.terminal import busy, in_line


def declare(add) -> None:
    parser = given.command(add, "learn", run,
                           "print the best parameters of finished sweeps over one grid, and leave-one-out tables")
    parser.add_argument("runs", nargs="+", metavar="RUN", help="folders that sweep wrote")
    parser.add_argument("--by", action="append", metavar="FACTORS",
                        help=f"a table by one or more of {', '.join(FACTORS)}, joined by commas; repeat for further tables "
                             "(default: those of the paper that the runs allow)")
    parser.add_argument("--end-distances", metavar="MM,MM",
                        help="end distances to compare in tables by end distance (default: all)")
    parser.add_argument("--out", metavar="FOLDER",
                        help="folder for learn.json and the tables as .csv and .md (default: not written)")


def run(options: Namespace, words: list[str]) -> int:
    """The best Θ of each run with the ranges that fit nearly as well (§III-E), then leave-one-out tables of all runs."""
    out = given.output_folder(options.out)
    distances = given.numbers("--end-distances", options.end_distances)
    asked = [tuple(factor.strip() for factor in by.split(",")) for by in options.by or []]
    with busy("reading runs"):
        landscapes = [read_landscape(Path(run)) for run in options.runs]
    check_comparable(landscapes)
    partitions = {found[0].by: found for found in
                  (partition(landscapes, by, distances) for by in asked or usual_factors(landscapes))}
    if distances and not any("end-distance" in by for by in partitions):
        raise InputError(given.SOURCE, "--end-distances", "no table is by end distance", "add --by end-distance")
    with busy("cross-validating"):
        tables = {by: [cross_validate(one) for one in found] for by, found in partitions.items()}
    every = [scores for found in tables.values() for scores in found]
    summary = plain({"runs": [_best_of(landscape) for landscape in landscapes],
                     "tables": [_as_dict(scores) for scores in every]})
    if out is not None:
        _write(out, summary, tables)

    def lines() -> list[str]:
        found = [line for landscape in landscapes for line in run_lines(landscape.as_dict())]
        found += [f"\n{text(scores, get_terminal_size((120, 24)).columns)}" for scores in every]
        return found if out is None else [*found, f"\nwritten to {in_line(out)}"]

    report(options, summary, lines)
    return 0


def _best_of(landscape: Landscape) -> dict:
    """The best Θ of a run, as JSON holds it."""
    result = landscape.as_dict()
    status = result.pop("rods")
    del status["count"]
    return {"run": str(landscape.run), **{name: result[name] for name in ("material", "objective", "jumps") if name in result},
            **result["best"], "intervals": result["intervals_within_5_percent"], "stable": status.pop("stable"),
            "status": status, **landscape.competition}


def _as_dict(scores: Scores) -> dict:
    parts = scores.partition
    return {"caption": caption(scores), "by": parts.by, "within": parts.within, "unlabelled": parts.unlabelled,
            "training_error_mm": dict(zip((part.label for part in parts.parts), scores.training, strict=True)),
            "entries": entries(scores)}


def _write(out: Path, summary: dict, tables: dict[tuple[str, ...], list[Scores]]) -> None:
    """learn.json, and for each partition a CSV and a Markdown file."""
    save_json(out / "learn.json", summary)
    for by, found in tables.items():
        write_text(out / f"{file_stem(by)}.csv", comma_separated(found))
        write_text(out / f"{file_stem(by)}.md", "\n".join(markdown(scores) for scores in found))
