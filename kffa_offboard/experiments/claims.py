"""The paper's claims, and what became of them: published text, measured text, verdict, all from numbers."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal

from kffa_offboard.control.controllers import CHANNELS
from kffa_offboard.experiments.examples import Example

Verdict = Literal["holds", "holds with another reading", "does not hold"]
HOLDS: Verdict = "holds"
OTHER: Verdict = "holds with another reading"
FAILS: Verdict = "does not hold"

#: Table 4: settling times, s; None is the printed dash (not before 1.2 s). The text gives the 1.09 s to yaw.
TABLE_4: dict[str, dict[str, float | None]] = {
    "pid": {"roll": None, "pitch": 1.09, "yaw": None, "altitude": None},
    "wb-ladrc": {"roll": 0.58, "pitch": 0.59, "yaw": 0.6, "altitude": 0.61},
    "ladrc": {"roll": 0.43, "pitch": 0.41, "yaw": 0.38, "altitude": 0.4},
    "fa-ladrc": {"roll": 0.29, "pitch": 0.3, "yaw": 0.29, "altitude": 0.3},
}
ORDER = ("pid", "wb-ladrc", "ladrc", "fa-ladrc")
BANDS = ("settling_2_percent_s", "settling_01_percent_s")


@dataclass(frozen=True)
class Claim:
    """One claim: what is claimed (by the paper, or found here), what was measured, and the verdict."""

    example: Example
    claim: str
    measured: str
    verdict: Verdict


def judge(results: dict[str, Any], examples: Iterable[int]) -> list[Claim]:
    """All claims about the examples that were flown."""
    judges = {1: _EXAMPLE_1, 2: _EXAMPLE_2, 3: _EXAMPLE_3, 4: _EXAMPLE_4}
    return [
        Claim(example, *one(results[f"example{example}"])) for example in examples for one in judges[example]
    ]


Judged = tuple[str, str, Verdict]


def _verdict(holds: bool, otherwise: bool = False) -> Verdict:
    return HOLDS if holds else OTHER if otherwise else FAILS


def span(values: Iterable[float], digits: int = 2) -> str:
    """``0.20-0.24``: smallest and largest of some numbers; ``never`` is infinity."""
    low, high = min(values := list(values)), max(values)
    shown = [f"{value:.{digits}f}" if value < float("inf") else "never" for value in (low, high)]
    return shown[0] if shown[0] == shown[1] else f"{shown[0]} to {shown[1]}"


def _settling(example: dict[str, Any], label: str, direction: str = "up") -> list[dict[str, float]]:
    step = example["controllers"][label][direction]
    return [step[band] for band in BANDS]


def _ordered(example: dict[str, Any], band: str) -> list[str]:
    """Channels in which the four settle in the published order."""
    times = [example["controllers"][label]["up"][band] for label in ORDER]
    return [
        channel
        for channel in CHANNELS
        if all(slow[channel] > fast[channel] for slow, fast in pairwise(times))
    ]


def _pid_row(example: dict[str, Any]) -> Judged:
    two, tight = _settling(example, "pid")
    plain = example["controllers"]["pid/no-integral"]["up"][BANDS[0]]
    slower = sum(value > 1.2 for value in two.values()) >= 3
    return (
        "Table 4: the PID is not steady within 1.2 s, but for one channel (1.09 s).",
        f"A PID tuned for step and load settles to 2 % in {span(two.values())} s (0.1 %: "
        f"{span(tight.values())} s), "
        f"with {span(example['controllers']['pid']['up']['overshoot_percent'].values(), 0)} % overshoot. "
        f"Without integral and "
        f"tuned for this step alone it takes {span(plain.values())} s, no more than LADRC: on an ideal "
        f"double "
        "integrator a step does not tell them apart; the load of Example 3 does.",
        _verdict(slower),
    )


def _wb_row(example: dict[str, Any]) -> Judged:
    two, tight = _settling(example, "wb-ladrc")
    return (
        "Table 4: WB-LADRC takes about 0.6 s, with minimal overshoot.",
        f"0.1 %: {span(tight.values())} s, 2 %: {span(two.values())} s, overshoot "
        f"{span(example['controllers']['wb-ladrc']['up']['overshoot_percent'].values(), 1)} %. Not "
        f"evidence: its gains are unstated "
        "and were read back from this row. It has no other difference from LADRC.",
        _verdict(False, all(abs(value - 0.6) < 0.1 for value in tight.values())),
    )


def _ladrc_row(example: dict[str, Any]) -> Judged:
    two, tight = _settling(example, "ladrc")
    return (
        "Table 4: LADRC takes 0.38 to 0.43 s (target: at most 0.43 s in all channels).",
        f"2 %: {span(two.values())} s; 0.1 %: {span(tight.values())} s, which resembles the printed numbers.",
        _verdict(max(two.values()) <= 0.43 and max(tight.values()) <= 0.43),
    )


def _fa_row(example: dict[str, Any]) -> Judged:
    two, tight = _settling(example, "fa-ladrc")
    return (
        "Table 4: FA-LADRC takes 0.29 to 0.30 s (target: at most 0.30 s in all channels).",
        f"2 %: {span(two.values())} s; 0.1 %: {span(tight.values())} s. The 2 % band meets it; the 0.1 % "
        f"band, "
        "in which LADRC's row comes out, does not: a correction of at most 4 rad/s cannot take a quarter "
        "off.",
        _verdict(max(tight.values()) <= 0.30, max(two.values()) <= 0.30),
    )


def _order(example: dict[str, Any]) -> Judged:
    found = {band: _ordered(example, band) for band in BANDS}
    complete = [len(channels) == len(CHANNELS) for channels in found.values()]
    plain, ladrc = (_settling(example, label)[0] for label in ("pid/no-integral", "ladrc"))
    quicker = [channel for channel in CHANNELS if plain[channel] < ladrc[channel]]
    return (
        "Settling: PID slower than WB-LADRC, slower than LADRC, slower than FA-LADRC, in every channel.",
        f"In this order, 2 %: {', '.join(found[BANDS[0]]) or 'no channel'}; "
        f"0.1 %: {', '.join(found[BANDS[1]]) or 'no channel'}. FA-LADRC gains "
        f"{span(_gain_ms(example), 0)} ms on LADRC (2 %). Only LADRC's numbers are "
        "all published. FA-LADRC's scaling was chosen so that it gains, WB-LADRC's gains were read back from "
        "Table 4, a PID that may overshoot by 40 % (see docs/paper.md) is quicker than WB-LADRC on "
        "height, and one without integral is quicker than LADRC (2 %) on "
        f"{', '.join(quicker) or 'no channel'}.",
        _verdict(all(complete) and not quicker, any(complete)),
    )


def _gain_ms(example: dict[str, Any]) -> list[float]:
    slow, fast = (_settling(example, label)[0] for label in ("ladrc", "fa-ladrc"))
    return [1000.0 * (slow[channel] - fast[channel]) for channel in CHANNELS]


def _overshoot(example: dict[str, Any]) -> Judged:
    largest = {
        label: max(example["controllers"][label]["up"]["overshoot_percent"].values())
        for label in ("ladrc", "fa-ladrc", "kffa-ladrc")
    }
    return (
        "LADRC and FA-LADRC do not overshoot (target: at most 1 %).",
        "; ".join(f"{label} {value:.2f} %" for label, value in largest.items())
        + ". KFFA-LADRC's is on yaw, where b0 of Table 3 is 1.7 times too small and the Kalman filter "
        "believes it; with the intensity of the other channels it would be 1.4 % (see configs/paper.toml).",
        _verdict(max(largest.values()) <= 1.0),
    )


def _kalman_speed(example: dict[str, Any]) -> Judged:
    with_filter, without = (_settling(example, label)[0] for label in ("kffa-ladrc", "fa-ladrc"))
    tail = span(_settling(example, "kffa-ladrc")[1].values())
    faster = [channel for channel in CHANNELS if with_filter[channel] < without[channel]]
    return (
        "The Kalman filter enhances the system's response speed.",
        f"KFFA-LADRC settles (2 %) in {span(with_filter.values())} s, FA-LADRC in "
        f"{span(without.values())} s; faster on "
        f"{', '.join(faster) or 'no channel'}. The 0.1 % band takes KFFA-LADRC {tail} s: the filter adds "
        f"a slow tail.",
        _verdict(len(faster) == len(CHANNELS)),
    )


def _differentiator(example: dict[str, Any]) -> Judged:
    alone = example["differentiator_alone"][BANDS[0]]
    followed = _settling(example, "fa-ladrc/td")[0]
    return (
        "The TD with i = 200 and h0 = 0.1 stands in the loop that Table 4 measures.",
        f"The TD alone takes {span(alone.values())} s to 2 % of the step, FA-LADRC behind it "
        f"{span(followed.values())} s, like LADRC: 0.30 s is out of reach. Table 4 was flown without it.",
        _verdict(max(followed.values()) <= 0.35),
    )


def _down(example: dict[str, Any]) -> Judged:
    def lost(label: str) -> list[float]:
        up, down = (_settling(example, label, direction)[0] for direction in ("up", "down"))
        return [1000.0 * (down[channel] - up[channel]) for channel in CHANNELS]

    published, even = lost("fa-ladrc"), lost("fa-ladrc/even")
    symmetric = min(published) < 1.0
    return (
        "The rules of Table 2 make FA-LADRC faster (not said in the paper: in either direction).",
        f"A step down is {span(published, 0)} ms slower than a step up, and slower than LADRC's: the "
        f"table is odd, and e < 0 lowers "
        f"omega_c. With the even rule base the difference is {span([abs(value) for value in even], 1)} ms.",
        _verdict(symmetric, max(abs(value) for value in even) < 2.0),
    )


_EXAMPLE_1: tuple[Callable[[dict[str, Any]], Judged], ...] = (
    _pid_row,
    _wb_row,
    _ladrc_row,
    _fa_row,
    _order,
    _overshoot,
    _kalman_speed,
    _differentiator,
    _down,
)


def _triangle_lag(example: dict[str, Any]) -> Judged:
    found = example["controllers"]
    plain = {
        label: found[label]["lag_s"].values() for label in ("wb-ladrc", "ladrc", "fa-ladrc", "kffa-ladrc")
    }
    tracked = found["fa-ladrc/td"]["lag_s"].values()
    largest = max(max(values) for values in plain.values())
    return (
        "Triangle: WB-LADRC, LADRC and FA-LADRC follow about 0.1 s late (target: at most 0.1 s).",
        "; ".join(f"{label} {span(values, 3)} s" for label, values in plain.items())
        + f"; with the TD {span(tracked, 3)} s. 2/omega_c is the theory.",
        _verdict(largest <= 0.1),
    )


def _triangle_order(example: dict[str, Any]) -> Judged:
    found = example["controllers"]

    def beats(better: str, worse: str) -> bool:
        return all(found[better]["rms_error"][c] < found[worse]["rms_error"][c] for c in CHANNELS)

    published = beats("ladrc", "wb-ladrc") and beats("fa-ladrc", "ladrc")
    even = beats("ladrc", "wb-ladrc") and beats("fa-ladrc/even", "ladrc")
    roll = {label: 1000.0 * found[label]["rms_error"]["roll"] for label in (*ORDER[1:], "fa-ladrc/even")}
    return (
        "Triangle: rms error falls from WB-LADRC to LADRC to FA-LADRC.",
        "Roll, mrad: "
        + ", ".join(f"{label} {value:.2f}" for label, value in roll.items())
        + ". With the published rules FA-LADRC gains going up what it loses coming down; the even ones "
        "gain both ways.",
        _verdict(published, even),
    )


def _triangle_pid(example: dict[str, Any]) -> Judged:
    found = example["controllers"]
    worst = all(
        found["pid"]["rms_error"][c] > found[label]["rms_error"][c] for c in CHANNELS for label in ORDER[1:]
    )
    return (
        "Triangle: the PID tracks poorly in all channels.",
        f"Its integral removes the lag ({span(found['pid']['lag_s'].values(), 3)} s): roll "
        f"{1000 * found['pid']['rms_error']['roll']:.1f} mrad rms against "
        f"{1000 * found['fa-ladrc']['rms_error']['roll']:.1f} of "
        "FA-LADRC. The LADRC law gets no rate of the reference without the TD.",
        _verdict(worst),
    )


_EXAMPLE_2 = (_triangle_lag, _triangle_order, _triangle_pid)


def _peaks(example: dict[str, Any], name: str = "load") -> dict[str, float]:
    return {
        label: 1000.0 * max(flown[name][event]["peak_m"] for event in ("pick_up", "drop"))
        for label, flown in example["controllers"].items()
    }


def _load_kalman(example: dict[str, Any]) -> Judged:
    peaks = _peaks(example)
    recovery = {
        label: 1000.0 * example["controllers"][label]["load"]["pick_up"]["recovery_s"]
        for label in ("fa-ladrc", "kffa-ladrc")
    }
    return (
        "A load moves KFFA-LADRC less than FA-LADRC, and it returns sooner.",
        f"Height, 5 kg: peak {peaks['kffa-ladrc']:.1f} mm against {peaks['fa-ladrc']:.1f} mm, back within "
        f"1 mm after "
        f"{recovery['kffa-ladrc']:.0f} ms against {recovery['fa-ladrc']:.0f} ms. Without noise a filter "
        f"can only be late; its "
        "gain is in Example 4.",
        _verdict(peaks["kffa-ladrc"] < peaks["fa-ladrc"]),
    )


def _load_pid(example: dict[str, Any]) -> Judged:
    peaks = _peaks(example)
    back = example["controllers"]["pid"]["load"]["pick_up"]["recovery_s"]
    return (
        "The load makes the PID unstable, FA-LADRC hardly moves.",
        f"Peak {peaks['pid']:.1f} mm, back within 1 mm after {back:.2f} s, against "
        f"{peaks['fa-ladrc']:.1f} mm: stable, five times "
        "further. KFFA-LADRC is no better than this PID here.",
        _verdict(back == float("inf"), back == float("inf")),
    )


def _load_gains(example: dict[str, Any]) -> Judged:
    found = example["controllers"]["fa-ladrc"]["load"]["pick_up"]
    altitude, roll = found["altitude_omega_c_change"], found["roll_omega_c_change"]
    return (
        "Figs 11 and 12: kp and kd of height and roll move when the load changes.",
        f"omega_c moves by {altitude:.4f} rad/s on height and by {roll:.2f} on roll. In eq 15 a load on "
        f"the vertical axis makes no "
        "torque and, at rest, changes nothing on roll. Only with a scaling as small as the load's own "
        "millimetres would Fig 11 move.",
        _verdict(roll > 0.01 and altitude > 0.01, False),
    )


def _load_limit(example: dict[str, Any]) -> Judged:
    peaks, inertia = _peaks(example, "limit"), _peaks(example, "limit-inertia")
    family = ("ladrc", "fa-ladrc", "kffa-ladrc")
    moved = max(abs(inertia[label] - peaks[label]) for label in family)
    return (
        "The same with Table 1's m_max, 6.73 kg and with the load's inertia, which the paper leaves out.",
        f"Peaks: FA-LADRC {peaks['fa-ladrc']:.1f} mm, KFFA-LADRC {peaks['kffa-ladrc']:.1f} mm, PID "
        f"{peaks['pid']:.1f} mm. At rest "
        f"the inertia changes nothing (below {max(moved, 0.001):.3f} mm).",
        _verdict(max(peaks[label] for label in family) < 20.0),
    )


def _loaded_step(example: dict[str, Any]) -> Judged:
    labels = ("pid", "ladrc", "fa-ladrc", "kffa-ladrc")
    found = {label: example["controllers"][label]["loaded-step"] for label in labels}
    shown = "; ".join(
        f"{label} {span([step[BANDS[0]]['roll']])}, overshoot {step['overshoot_percent']['roll']:.1f} %"
        for label, step in found.items()
    )

    def copes(label: str) -> bool:
        return all(found[label]["overshoot_percent"][channel] <= 2.0 for channel in ("roll", "pitch"))

    return (
        "The load's inertia may be left out of the model, the observer takes care of it (Table 1).",
        "A roll step of 0.5 rad under 6.73 kg, whose inertia makes Table 1's 2.2 times as large (s to 2 %): "
        f"{shown}. FA-LADRC hardly notices. KFFA-LADRC rings: its Kalman filter believes a b0 that is then "
        "three times too large, and what it takes for noise the observer behind it never sees.",
        _verdict(copes("fa-ladrc") and copes("kffa-ladrc"), copes("fa-ladrc")),
    )


_EXAMPLE_3 = (_load_kalman, _load_pid, _load_gains, _load_limit, _loaded_step)
KALMAN = "kffa-ladrc : fa-ladrc"
EVEN = "kffa-ladrc/even : fa-ladrc/even"
LITERAL = "kffa-ladrc/literal : fa-ladrc"


def _ratio(key: str, limit: float, text: str) -> Callable[[dict[str, Any]], Judged]:
    def judged(example: dict[str, Any]) -> Judged:
        def shares(pair: str, kind: str = "mean") -> list[float]:
            return [float(case[key][kind]) for case in example["ratios"][pair].values()]

        found = {pair: shares(pair) for pair in (KALMAN, EVEN, LITERAL)}
        return (
            f"With noise the Kalman filter lowers {text} (target: to at most {limit:g} times).",
            f"{span(found[KALMAN], 3)} times (worst seed {max(shares(KALMAN, 'worst')):.3f}); with the "
            f"even rules "
            f"{span(found[EVEN], 3)}; with the literal two-state filter {span(found[LITERAL], 3)}.",
            _verdict(False, max(found[KALMAN]) <= limit),
        )

    return judged


def _fuzzy_noise(example: dict[str, Any]) -> Judged:
    found = {label: example["controllers"][label]["load"] for label in ("ladrc", "fa-ladrc", "fa-ladrc/even")}
    rms = {label: 1000.0 * case["rms_error"]["roll"] for label, case in found.items()}
    mean = 1000.0 * found["fa-ladrc"]["mean_error"]["roll"]
    return (
        "With noise FA-LADRC tracks with a smaller error than LADRC.",
        "Roll, mrad rms: "
        + ", ".join(f"{label} {value:.0f}" for label, value in rms.items())
        + f". The published rules raise kp for one sign of the noise and lower it for the other: they "
        f"rectify it into a constant "
        f"error of {mean:.0f} mrad. That is most of what the Kalman filter then removes.",
        _verdict(rms["fa-ladrc"] < rms["ladrc"], rms["fa-ladrc/even"] < rms["ladrc"]),
    )


_EXAMPLE_4: tuple[Callable[[dict[str, Any]], Judged], ...] = (
    _ratio("roll_omega_c_spread", 0.25, "the spread of omega_c on roll"),
    _ratio("roll_rms_error", 0.25, "the roll error"),
    _ratio("altitude_rms_error", 0.5, "the height error"),
    _ratio("roll_effort", 0.25, "the control effort on roll"),
    _ratio("altitude_effort", 0.25, "the control effort on height"),
    _fuzzy_noise,
)
