"""How the commands tell their results: lines for a person, or strict JSON for a machine."""

import sys

import numpy as np

from doo_ti.grid import Grid, Interval
from doo_ti.terminal import in_line, visible


def busy(doing: str):
    """Says on a terminal what is being done, until it is."""
    from rich.console import Console
    from rich.text import Text

    return Console(stderr=True).status(Text(visible(doing)))  # not a string, whose [markup] would be obeyed


def theta_text(theta: dict, isotropic: bool) -> str:
    """Θ for a person."""
    names = ["bend_1"] if isotropic else ["bend_1", "bend_2"] + ["bend_12"] * bool(theta["bend_12"])
    bend = ", ".join(f"{'bend' if isotropic else name} {theta[name]:.4g} mm³" for name in names)
    return f"{bend}, twist {theta['twist']:.4g} mm³, weight {theta['weight']:.4g}"


def counted(counts: dict[str, int]) -> str:
    return ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in counts.items())


def plain(value):
    """``value`` as strict JSON holds it: no NumPy types, null for what is not finite."""
    if isinstance(value, dict):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(entry) for entry in value]
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value


def peak_memory() -> int:
    """Bytes that this process held at most; 0 where the system does not tell."""
    try:
        import resource
    except ImportError:  # Windows
        return 0
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else 1024 * peak


def tell_result(result: dict) -> None:
    """What a run's overview, or its summary, holds."""
    grid, rods, best = Grid.from_dict(result["grid"]), dict(result["rods"]), result["best"]
    count, stable = rods.pop("count"), rods.pop("stable")
    cells, terms = result["cells"], "observations" if result["objective"] == "static" else "pairs of observations (Eq. 3)"
    per_cell = count // cells
    print(f"{in_line(result['material'])}: {cells} cells x {per_cell} {terms}")
    print(f"  best cell   {theta_text(best, grid.is_isotropic)}")
    print("              (the cell that fits best if the rod is straight at rest and clamped as the marks say)")
    print(f"  distance    mean {best['mean_distance_mm']:.4g} mm (Eq. 1)")
    for interval in (Interval(**entry) for entry in result["intervals_within_5_percent"]):
        print(f"  flatness    {interval}{' (at the border of the grid: widen it)' * interval.at_border}")
    print("              (cells within 5 % of the smallest error; this is not an uncertainty)")
    print(f"  status      {counted(rods)}; {stable} certified stable")
    print(f"  competing   {result['cells_competing']} of {cells} cells; in {result['cells_not_competing']} some rod is no "
          "certified minimum")
    if result["terms_left_out"]:
        print(f"              left out: {result['terms_left_out']} of {per_cell} {terms}, whose rods are certified in no cell")
    if "jumps" in result:
        fell = result["jumps"]
        print(f"  jumps       {fell['rods_at_best']} of {per_cell} rods fell to another branch on their way in the best cell, "
              f"{fell['rods']} of {count} in all")


def tell_hypotheses(summary: dict) -> None:
    """What became of the hypotheses about whole turns and spins, where there were several."""
    found = summary.get("hypotheses")
    if found is None:
        return
    kept, ambiguous = found["kept"], set(found["ambiguous"])
    print(f"  hypotheses  {found['hypotheses']}; one settled for {found['resolved']} observations, {len(ambiguous)} ambiguous, "
          "which take the nearest in each cell")
    pairs = zip(kept["observation"], kept["turns"], strict=True)
    settled = [turn for observation, turn in pairs if observation not in ambiguous]
    turns = ", ".join(f"{turn:+d}: {settled.count(turn)}" for turn in sorted(set(settled)))
    if turns:
        print(f"              whole turns settled: {turns}; each one's is in summary.json")
    if ambiguous:
        print(f"              ambiguous observations: {', '.join(map(str, sorted(ambiguous)))}")
