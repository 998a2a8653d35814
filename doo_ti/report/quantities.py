"""How pictures and recordings write parameters, values and units."""

import numpy as np

MEAN_DISTANCE = "mean distance (Eq. 1) [mm]"
"""What a landscape's colours and heights are."""
SYMBOLS = {
    "bend": "bend α", "bend_1": "bend B₁₁", "bend_2": "bend B₂₂", "bend_12": "bend B₁₂", "twist": "twist β",
    "twist_ratio": "twist ratio β/α", "weight": "weight μ",
}
"""How the axes of the grid are written; other names stay as they are."""


def quantity(value: float, unit: str = "") -> str:
    """A value with its unit for a person: three digits, powers of ten from 10⁴ on."""
    value = float(f"{value:.2e}")
    if value == 0 or 1e-2 <= abs(value) < 1e4 or not np.isfinite(value):
        text = f"{value:.3g}"
    else:
        mantissa, exponent = f"{value:.2e}".split("e")
        power = str(int(exponent)).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
        mantissa = mantissa.rstrip("0").rstrip(".")
        text = f"10{power}" if mantissa == "1" else f"{mantissa}×10{power}"
    return f"{text} {unit}".rstrip()


def axis_label(axis) -> str:
    """Name, symbol and unit of a grid axis: ``bend α [mm³]``."""
    name, _, _, unit = axis
    return SYMBOLS.get(name, name) + (f" [{unit}]" if unit else "")


def values_text(values) -> str:
    """(name, value, unit) of several parameters in one line, by their symbols: ``α = 10⁶ mm³, β/α = 0.5``."""
    return ", ".join(f"{SYMBOLS.get(name, name).split()[-1]} = {quantity(value, unit)}" for name, value, unit in values)
