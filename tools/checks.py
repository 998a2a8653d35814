"""Measured figures of a study beside the values they have to reach, as a table."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Check:
    """One line of the table; ``holds`` is None where nothing could be measured."""

    name: str
    bar: str
    measured: str
    holds: bool | None


def table(checks: list[Check]) -> str:
    """As Markdown."""
    lines = ["| check | bar | measured | holds |", "|---|---|---|---|"]
    verdict = {True: "yes", False: "**no**", None: "–"}
    return "\n".join(lines + [f"| {c.name} | {c.bar} | {c.measured} | {verdict[c.holds]} |" for c in checks])
