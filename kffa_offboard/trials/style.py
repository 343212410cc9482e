"""How figures of flights look."""

from __future__ import annotations

from typing import Any

BLUE, ORANGE, GREEN, VIOLET, GREY = "#1f5fa8", "#d9731a", "#2e8b57", "#8450a0", "#7a7a7a"

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
