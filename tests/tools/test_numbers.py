"""docs/numbers.md: every measured number of the documents is there with a command, and still stands in its page."""

import re
import shlex
from pathlib import Path

import pytest

from doo_ti.commands.help_text import EXAMPLES

ROOT = Path(__file__).resolve().parents[2]
LISTED = [(page, quotation, command, bool(data)) for page, quotation, command, data in re.findall(
    r"^\| \[[\w.]+\]\(([\w./]+)\) \| (.+?) \| `([^`]+)`( \(not shipped\))? \|$",
    (ROOT / "docs" / "numbers.md").read_text(encoding="utf-8"), re.MULTILINE)]
WRITTEN = {"numbers.md", "figures.md", "peers.md", "validation.md", "reference.md"}
"""Pages that list, or that a tool writes as a whole."""
PAGES = [ROOT / "README.md", *(page for page in sorted((ROOT / "docs").glob("*.md")) if page.name not in WRITTEN)]
MEASURED = re.compile(
    r"\d ?%|\d ?(?:µs|ms|rods/s|Jacobians/s|loads/s|GB/s|kB|MB|GB)\b|\b\d+ of \d+\b|\d (?:times|s|seconds|minutes?)\b"
    r"|\d\.\d+ (?:mm|px)\b|\de-\d|10⁻|\b1/\d{3}\b| ± ")
"""What a measured number looks like: a share, a time, a rate, a count of so many, an error."""
GIVEN = {
    "README.md": ["with a 95 % interval", "EI and GJ with 95 % intervals"],
    "compared.md": ["rest curvature with 95 % intervals"],
    "cables.md": ["six slowest stretches of 1.5 s"],
    "cameras.md": ["Limits: file size 1 MB", "a standard deviation of a focal length above 5 % is refused", "default 0.5 px"],
    "chain.md": ["to 1e-7 of it, is taut", "10⁻¹² of the largest entry, of rods among obstacles and of groups 10⁻⁹, is added",
                 "The first shift δ on the diagonal is 0.05",
                 "f32 ends at a residual of 10⁻⁴", "near rest (residual below 10⁻³)",
                 "length by 3·10⁻⁵ rad too"],
    "contact.md": ["or the forces of the step before by 30 %", "next step would be below 10⁻¹⁰ rad"],
    "dynamics.md": ["moved back to 99.9 % of its reach"],
    "forces.md": ["they are mN and 10⁻⁶ N m"],
    "groups.md": ["is in N and 1e-3 group.newton moment", "and ε = 10⁻⁸/κ makes ties",
                  "with ten times as large a κ", "a share of 10⁻⁹ of the largest diagonal entry"],
    "learning.md": ["The ± is over the configurations of one specimen", "± is the standard error, sd/√n"],
    "observations.md": ["20 times as long as the others"],
    "perception.md": ["0.1 px or more, or no other rod", "0.02 px or more"],
    "recording.md": ["with the range of each parameter within 5 % of the minimum", "Outlined: within 5 % of it"],
    "refinement.md": ["whose observations do not ship: bend 6.81e5", "begins to bend at 2.5 mm", "95 % quantile",
                      "joint 95 % region", "draws random specimens of the virtual lab", "truth in its 95 % interval"],
    "sweeps.md": ["parameters with 95 % intervals", "the cells within 5 % of it are marked"],
    "tracking.md": ["within 1.5 px of the detection"],
    "twist.md": ["its shape after 1.5 s of motion at 0.2 m/s", "the 95 % interval of φ",
                 "The 95 % interval reaches to the outermost angles"],
}
"""Numbers that look measured and are limits, defaults, definitions or descriptions of a set-up."""


def plain(text: str) -> str:
    """Without the marks of Markdown, on one line."""
    return " ".join(re.sub(r"[*`]", "", text.replace("|", " ")).split())


def paragraphs(page: Path) -> list[str]:
    """Paragraphs, and rows of tables, without blocks of code."""
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    blocks = [block for block in re.split(r"\n\s*\n", text) if not all(line.startswith("    ") for line in block.splitlines())]
    return [plain(part) for block in blocks for part in (block.splitlines() if block.lstrip().startswith("|") else [block])]


def test_the_page_is_read():
    assert len(LISTED) == sum(line.startswith("| [") for line in (ROOT / "docs/numbers.md").read_text().splitlines()) > 100


@pytest.mark.parametrize("page", sorted({page for page, *_ in LISTED}))
def test_every_quotation_still_stands_in_its_page(page):
    path = ROOT / "docs" / page
    text = plain(path.read_text(encoding="utf-8"))
    for where, quotation, _, missing in LISTED:
        if where == page:
            assert plain(quotation) in text, f"{page} no longer says: {quotation}"
            says = re.search(r"(?:do|does) not ship|not shipped", text)
            assert not missing or says, f"{page} does not say that it needs data which does not ship"


def test_every_command_exists():
    for _, quotation, command, _ in LISTED:
        words = shlex.split(command)
        if words[0] == "doo-ti":
            assert words[1] in EXAMPLES, command
        else:
            assert words[0] == "python", command
            named = words[1:] if words[1] != "-m" else words[3:4]
            assert not named or (ROOT / named[0]).exists(), f"{quotation}: {command}"
        scenes = [word for word in words if word.startswith("scenes/")]
        assert all((ROOT / scene).is_file() for scene in scenes), command


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_no_measured_number_is_missing(page):
    known = [plain(quotation) for where, quotation, *_ in LISTED if Path(where).name == page.name] + GIVEN.get(page.name, [])
    for paragraph in paragraphs(page):
        if MEASURED.search(paragraph):
            assert any(quotation in paragraph for quotation in known), f"{page.name}: not in docs/numbers.md: {paragraph[:300]}"
