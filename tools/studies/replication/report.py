"""REPLICATION.md: verdicts, numbers beside the paper's, and why they differ."""

from dataclasses import dataclass
from pathlib import Path

from tools.studies.replication.criteria import CRITERIA, Verdict, verdict
from tools.studies.replication.settings import SETTINGS, Size
from tools.studies.replication.study import Found


@dataclass(frozen=True)
class Outcome:
    """Of one item: ``found``, or the ``problem`` that kept it from running; the seconds it took, and those of processors."""

    name: str
    found: Found | None
    problem: str
    seconds: float
    processor: float

    @classmethod
    def from_dict(cls, content: dict) -> "Outcome":
        """What ``dataclasses.asdict`` made."""
        return cls(**{**content, "found": content["found"] and Found(**content["found"])})

    @property
    def failures(self) -> list[str]:
        """What makes the run fail: an item that did not run, or a criterion that is worse than what the documents claim."""
        if self.found is None:
            return [f"{self.name}: did not run: {self.problem}"]
        failed = []
        for key, criterion in CRITERIA.get(self.name, {}).items():
            for setting, claimed in zip(SETTINGS, criterion.claimed, strict=True):
                measured = verdict(self.found.held[setting.name][key])
                if list(Verdict).index(measured) < list(Verdict).index(claimed):
                    failed.append(f"{self.name}, {setting.name}: {criterion.text}: claimed {claimed}, found {measured}")
        return failed


def report(outcomes: list[Outcome], command: str, machine: dict, note: str, size: Size) -> str:
    """The text of the file; ``machine`` is that of :func:`doo_ti.lab.workload.machine`, ``note`` a remark on the run."""
    laboratory, reasons = _reasons()
    seconds, processor = (sum(getattr(outcome, name) for outcome in outcomes) for name in ("seconds", "processor"))
    lines = [
        "# Replication", "",
        f"Written by `{command}` ({size.name}, {seconds / 60:.0f} minutes, {processor / 60:.0f} of processor time, on "
        f"{machine['processor']}, {machine['cores']} cores{'; ' * bool(note)}{note}). Do not edit: change the tool, "
        "and run it again.", "", laboratory, "",
        "## Verdicts", "",
        "A criterion is tested on each specimen: *reproduced* where it holds for at least 80 %, *partly* from 20 % on, else "
        "*not*. Criteria are stated in `tools/studies/replication/criteria.py`; *here*: the paper states none.", "",
        "| item | criterion | of | as the paper | as this package |", "|---|---|---|---|---|",
    ]
    for outcome in outcomes:
        for key, criterion in CRITERIA.get(outcome.name, {}).items():
            source = "the paper" if criterion.source == "paper" else "here"
            entries = ["did not run"] * 2 if outcome.found is None else [
                _entry(outcome.found.held[setting.name][key]) for setting in SETTINGS]
            lines.append(f"| {outcome.name} | {criterion.text} | {source} | " + " | ".join(entries) + " |")
    images = ", ".join(f"{count} × {sets} sets a material {name}" for name, (count, sets) in size.images.items())
    lines += ["", f"± is the standard error over specimens. Specimens: {size.specimens} of each suture, {size.ribbons} of the "
              f"ribbon; of images {images}; {size.harder[0]} in each harder laboratory. Tables: paper / as the paper / as this "
              "package."]
    for outcome in outcomes:
        lines += ["", f"## {outcome.name}", ""]
        lines += [f"Did not run: {outcome.problem}"] if outcome.found is None else outcome.found.lines
        lines += ["", reasons.get(outcome.name, "")]
    lines += ["", "## Time", "", "| item | s | of processor time |", "|---|---|---|"]
    lines += [f"| {outcome.name} | {outcome.seconds:.0f} | {outcome.processor:.0f} |" for outcome in outcomes]
    return "\n".join(lines).replace("\n\n\n", "\n\n") + "\n"


def _reasons() -> tuple[str, dict[str, str]]:
    """What the report says beside the numbers: its introduction, and a text for each item."""
    first, *sections = (Path(__file__).parent / "reasons.md").read_text(encoding="utf-8").split("\n## ")
    return first.strip(), {name: text.strip() for name, _, text in (section.partition("\n") for section in sections)}


def _entry(held: list[bool]) -> str:
    return f"**{verdict(held)}** ({sum(held)} of {len(held)})"
