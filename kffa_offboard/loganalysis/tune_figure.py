"""The tuned loops: Bode plots with the margins marked and Nyquist curves, by python-control."""

from __future__ import annotations

from pathlib import Path

import control
import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from kffa_offboard.loganalysis.loop_model import LinearSystem
from kffa_offboard.loganalysis.margins import Wanted, frequencies
from kffa_offboard.loganalysis.tune import TunedChannel, Tuning


def as_control(system: LinearSystem) -> control.StateSpace:
    """The same system for python-control."""
    return control.StateSpace(system.a, system.b, system.c, system.d, system.period_s)


def draw(path: Path, tuned: list[TunedChannel], wanted: Wanted) -> None:
    """One column a channel: gain, phase, Nyquist."""
    figure, axes = plt.subplots(
        3, len(tuned), figsize=(4.0 * len(tuned) + 1.0, 10.0), squeeze=False, constrained_layout=True
    )
    for column, channel in enumerate(tuned):
        omega = frequencies(channel.loop.period_s)
        response = control.frequency_response(as_control(channel.loop), omega)
        loop = np.asarray(response.complex).reshape(-1)
        _bode(axes[0, column], axes[1, column], channel, omega, loop)
        _nyquist(axes[2, column], loop, wanted)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def draw_trade_off(path: Path, tuning: Tuning) -> None:
    """What margins cost: each of them over the peak when half the vehicle's mass comes or goes."""
    found = [candidate for _, candidate in tuning.trade_off]
    peaks = [candidate.peak for candidate in found]
    chosen = tuning.channels[-1]
    assert chosen.altitude is not None
    peak = max(chosen.altitude.pick_up_peak_m, chosen.altitude.drop_peak_m)
    rows = (
        ("gain margin, dB", [one.margins.gain_db for one in found], chosen.margins.gain_db),
        ("phase margin, deg", [one.margins.phase_deg for one in found], chosen.margins.phase_deg),
        ("delay margin, ms", [1e3 * one.margins.delay_s for one in found], 1e3 * chosen.margins.delay_s),
    )
    figure, axes = plt.subplots(3, 1, figsize=(6.0, 7.0), sharex=True, constrained_layout=True)
    for axis, (label, values, own) in zip(axes, rows, strict=True):
        axis.plot(peaks, values, marker="o", ms=4)
        axis.plot(peak, own, "r", marker="D", ms=7, ls="", label="chosen")
        axis.set_ylabel(label)
        axis.grid(alpha=0.3)
    axes[0].legend()
    axes[2].set_xlabel("peak when half the vehicle's mass is picked up or dropped, m")
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _bode(
    gain: Axes, phase: Axes, channel: TunedChannel, omega: NDArray[np.float64], loop: NDArray[np.complex128]
) -> None:
    margins = channel.margins
    decibels = 20.0 * np.log10(np.abs(loop))
    degrees = np.degrees(np.unwrap(np.angle(loop)))
    gain.semilogx(omega, decibels)
    gain.axhline(0.0, color="0.5", lw=0.8)
    at = np.interp(margins.phase_crossover_rad_s, omega, decibels)
    gain.plot([margins.phase_crossover_rad_s] * 2, [0.0, at], "r", marker="o", ms=3)
    gain.set_title(
        f"{channel.name}: ωc {channel.omega_c:.2f}, ωo {channel.omega_o:.1f} rad/s\n"
        f"{margins.gain_db:.1f} dB, {margins.phase_deg:.0f}°, {1e3 * margins.delay_s:.0f} ms",
        fontsize=10,
    )
    gain.set_ylabel("gain, dB")
    degrees = about_minus_180(degrees, float(np.interp(margins.crossover_rad_s, omega, degrees)))
    here = float(np.interp(margins.crossover_rad_s, omega, degrees))
    phase.semilogx(omega, degrees)
    phase.axhline(-180.0, color="0.5", lw=0.8)
    phase.plot([margins.crossover_rad_s] * 2, [-180.0, here], "r", marker="o", ms=3)
    phase.set_ylim(-360.0, 90.0)
    phase.set_ylabel("phase, degrees")
    phase.set_xlabel("rad/s")
    for axis in (gain, phase):
        axis.grid(alpha=0.3, which="both")


def about_minus_180(degrees: NDArray[np.float64], crossover_deg: float) -> NDArray[np.float64]:
    """The phase [degrees] less whole turns, so that the margin at the crossover stands on -180 degrees."""
    turns: int = round((crossover_deg + 180.0) / 360.0)
    return degrees - 360.0 * turns


def _nyquist(axis: Axes, loop: NDArray[np.complex128], wanted: Wanted) -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 200)
    axis.plot(np.cos(angle), np.sin(angle), color="0.7", lw=0.8)
    axis.plot(loop.real, loop.imag)
    axis.plot(-1.0, 0.0, "r+", ms=10)
    factor = 10.0 ** (wanted.gain_db / 20.0)
    axis.plot([-factor, -1.0 / factor], [0.0, 0.0], "r", lw=2.0, alpha=0.6)
    bound = np.radians(wanted.phase_deg)
    arc = np.linspace(np.pi - bound, np.pi + bound, 50)
    axis.plot(np.cos(arc), np.sin(arc), "r", lw=2.0, alpha=0.6)
    axis.set_xlim(-3.5, 1.5)
    axis.set_ylim(-2.5, 2.5)
    axis.set_aspect("equal")
    axis.grid(alpha=0.3)
    axis.set_xlabel("real (red: margins asked for)")
    axis.set_ylabel("imaginary")
