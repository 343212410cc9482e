"""Settings that could not fly are refused with the name and the value."""

from math import nan

import pytest

from kffa_offboard.offboard.segments import Land, Takeoff
from kffa_offboard.offboard.settings import FlightSettings, LimitSettings, SequenceSettings, TelemetrySettings


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: LimitSettings(thrust_min=0.9, thrust_max=0.5), "limits.thrust_min = 0.9"),
        (lambda: LimitSettings(thrust_max=1.5), "thrust_max = 1.5"),
        (lambda: LimitSettings(tilt_max_rad=1.2), "limits.tilt_max_rad = 1.2"),
        (lambda: LimitSettings(altitude_min_m=60.0), "limits.altitude_min_m = 60"),
        (lambda: LimitSettings(altitude_max_m=nan), "limits.altitude_max_m = nan"),
        (lambda: LimitSettings(body_rate_max_rad_s=(1.0, 0.0, 1.0)), "rate limit 0.0"),
        (lambda: LimitSettings(tilt_compensation_max_rad=1.6), "tilt_compensation_max_rad"),
        (lambda: TelemetrySettings(timeout_s=0.0), "telemetry.timeout_s = 0.0"),
        (lambda: TelemetrySettings(settle_time_s=nan), "telemetry.settle_time_s = nan"),
        (lambda: SequenceSettings(mode_retry_s=0.0), "sequence.mode_retry_s = 0.0"),
        (lambda: FlightSettings(ramp_rate_per_s=0.0), "flight.ramp_rate_per_s = 0.0"),
    ],
)
def test_numbers_that_make_no_sense_are_refused_by_name(make, words):
    with pytest.raises(ValueError) as error:
        make()
    assert words in str(error.value)


def test_service_settings_are_refused_when_parts_do_not_fit(fake):
    with pytest.raises(ValueError, match=r"hover_thrust = 0\.99"):
        fake.settings(hover_thrust=0.99)
    with pytest.raises(ValueError, match="touch-down is noticed below thrust"):
        fake.settings(limits=LimitSettings(thrust_min=0.3))
    with pytest.raises(ValueError, match=r"take-off altitude 60\.0 m is not below"):
        fake.settings(scenario=(Takeoff(60.0),))
    with pytest.raises(ValueError, match="makes landing a failsafe"):
        fake.settings(scenario=(Takeoff(5.0), Land()), limits=LimitSettings(altitude_min_m=0.5))
