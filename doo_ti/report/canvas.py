"""What every picture is drawn on, and ticks that a person reads."""

import numpy as np

from doo_ti.report.quantities import quantity

PICTURE_INCHES, PICTURE_DPI = (8.0, 6.0), 200
"""1600 × 1200 pixels."""
VIEWER_DPI = 80
"""Of pictures in a recording, where they stand beside others: the viewer leaves out pixels of larger ones."""


def new_figure(inches: tuple[float, float] = PICTURE_INCHES, dpi: int = PICTURE_DPI):
    """An empty figure on a canvas of its own."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=inches, dpi=dpi, layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def literal(text: str) -> str:
    """A name as matplotlib shows it as it is: between dollar signs it would read mathematics, and fail where there are none."""
    return text.replace("$", r"\$")


def pixels(figure) -> np.ndarray:
    """(H, W, 3) uint8 of a figure, which is laid out by this."""
    figure.canvas.draw()
    return np.asarray(figure.canvas.buffer_rgba())[..., :3].copy()


def plain_ticks(axis, is_log: bool, low: float, high: float) -> None:
    """Ticks a person reads: plain numbers or powers of ten; at 1, 2 and 5 where a log axis is short."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    if is_log:
        decades = np.log10(high / low)
        steps = (1,) if decades > 3 else (1, 3) if decades > 1.5 else (1, 2, 5) if decades > 0.5 else range(1, 10)
        axis.set_major_locator(LogLocator(subs=steps, numticks=20))
        axis.set_minor_formatter(NullFormatter())
    axis.set_major_formatter(FuncFormatter(lambda value, _: quantity(value)))
