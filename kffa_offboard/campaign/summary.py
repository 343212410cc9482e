"""A campaign in numbers: percentiles of what came out, and the flights that failed."""

from __future__ import annotations

from typing import Any

import numpy as np

from kffa_offboard.campaign.measure import FAILURES

PERCENTILES = (50, 90, 99, 100)
MEASURES = {
    "pickup_peak_m": "pick-up: peak [m]",
    "pickup_iae_m_s": "pick-up: IAE [m s]",
    "pickup_recovery_s": "pick-up: recovery [s]",
    "drop_peak_m": "drop: peak [m]",
    "drop_iae_m_s": "drop: IAE [m s]",
    "drop_recovery_s": "drop: recovery [s]",
    "hover_rms_m": "hover: rms [m]",
    "tilt_max_deg": "largest tilt [deg]",
}
"""Column and what people call it; the tilt is kept in radians and told in degrees."""


def summarise(columns: dict[str, Any]) -> dict[str, Any]:
    """Summary of one controller's flights, as plain numbers; percentiles are those of all flights."""
    flights = len(columns["flight"])
    told = {**columns, "tilt_max_deg": np.degrees(columns["tilt_max_rad"])}
    failed = np.flatnonzero(columns["failure"] != "")
    return {
        "flights": flights,
        "failed": len(failed),
        "failures": {reason: int((columns["failure"] == reason).sum()) for reason in FAILURES[1:]},
        "failed_flights": columns["flight"][failed].tolist(),
        "worst_flights": {
            name: int(columns["flight"][np.argmax(columns[name])])
            for name in ("pickup_peak_m", "drop_peak_m", "tilt_max_rad")
        },
        "percentiles": {
            name: {
                f"p{share}": float(value)
                for share, value in zip(PERCENTILES, np.percentile(told[name], PERCENTILES), strict=True)
            }
            for name in MEASURES
        },
    }


def percent_failed(summary: dict[str, Any]) -> str:
    """Like "1.40 % (140)"."""
    return f"{100.0 * summary['failed'] / summary['flights']:.2f} % ({summary['failed']:,})"
