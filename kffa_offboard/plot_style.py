"""How figures look, in one place: colours, matplotlib settings, a figure on its way to a file."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

BLUE, ORANGE, GREEN, VIOLET, GREY = "#1f5fa8", "#d9731a", "#2e8b57", "#8450a0", "#7a7a7a"
RED = "#c0233b"

#: Of flights laid over one another; readable on a light and on a dark ground.
FLIGHT_COLOURS = (
    "#2f7fd0", "#e07b1f", "#2fa36b", "#d03a52", "#9a63b8",
    "#8c6d46", "#d264a0", "#7f8a1f", "#17a2b8", "#808080",
)  # fmt: skip

STYLE: Any = {
    "font.family": "sans-serif",
    "font.size": 10.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#555555",
    "axes.grid": True,
    "axes.titlelocation": "left",
    "axes.titlesize": 10.5,
    "axes.titleweight": "bold",
    "grid.color": "#dddddd",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "legend.fontsize": 9.0,
    "lines.linewidth": 1.3,
}


@contextmanager
def figure_to(
    path: Path, size: tuple[float, float], dpi: int, changes: Any = None, metadata: Any = None
) -> Iterator[Any]:
    """An empty matplotlib figure of `size` inches in `STYLE`, saved to `path` at the end.

    `changes` are matplotlib settings that differ from `STYLE`; `metadata` goes into the file.
    """
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with mpl.rc_context({**STYLE, **(changes or {})}):
        figure = Figure(figsize=size, dpi=dpi, layout="constrained")
        FigureCanvasAgg(figure)
        yield figure
        figure.savefig(path, metadata=metadata)
