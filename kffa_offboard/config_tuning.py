"""The numbers of a configuration that may be changed in flight, under names of 16 characters.

The configuration's own models check every change, so a range is written down once. Changed values can be
stored in a second TOML file, `[parameters] file`, which `config.load` lays over the first.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import inf
from typing import Any, TypeAlias

from pydantic import BaseModel, ValidationError

from kffa_offboard.config_errors import explain
from kffa_offboard.config_tables import ConfigFile
from kffa_offboard.config_tuning_file import Key, as_toml, read_values
from kffa_offboard.config_units import quantity_of
from kffa_offboard.offboard.settings import ServiceSettings
from kffa_offboard.offboard.tuning import Tunable, TuningProblem, TuningStore

Build: TypeAlias = Callable[[ConfigFile], ServiceSettings]
"""From checked tables to settings; ValueError if they do not fit each other."""

_CHANNEL = {
    "omega_c": "OMEGA_C",
    "omega_o": "OMEGA_O",
    "omega_c_range": "OMEGA_C_RG",
    "delay_s": "DELAY_S",
    "lag_s": "LAG_S",
    "prediction_s": "PREDICT_S",
    "disturbance_intensity": "DIST_INT",
}
_ALTITUDE = _CHANNEL | {
    "hover_thrust": "HOVER_THR",
    "damping_per_s": "DAMPING",
    "acceleration_m_s2": "REF_ACCEL",
    "error_scale_m": "ERR_SCALE",
    "error_rate_scale_m_s": "ERR_RATE",
    "measurement_noise_m": "NOISE",
    "climb_rate_noise_m_s": "RATE_NOISE",
}
_ANGLE = _CHANNEL | {
    "rate_time_constant_s": "RATE_TC_S",
    "natural_frequency_rad_s": "NAT_FREQ",
    "damping_ratio": "DAMP_RATIO",
    "acceleration_rad_s2": "REF_ACCEL",
    "error_scale_rad": "ERR_SCALE",
    "error_rate_scale_rad_s": "ERR_RATE",
    "measurement_noise_rad": "NOISE",
    "rate_noise_rad_s": "RATE_NOISE",
}
_POSITION = _CHANNEL | {
    "reference_filter_s": "REF_FILT_S",
    "tilt_max_deg": "TILT_DEG",
    "error_scale_m": "ERR_SCALE",
    "error_rate_scale_m_s": "ERR_RATE",
    "measurement_noise_m": "NOISE",
    "velocity_noise_m_s": "RATE_NOISE",
    "braking_m_s2": "BRAKE_M_S2",
    "error_max_m": "ERR_MAX_M",
}
_LIMITS = {
    "tilt_max_deg": "TILT_DEG",
    "roll_rate_max_deg_s": "ROLL_DEG_S",
    "pitch_rate_max_deg_s": "PITCH_DEG_S",
    "yaw_rate_max_deg_s": "YAW_DEG_S",
    "body_rate_change_max_deg_s2": "RATE_DEG_S2",
    "thrust_min": "THR_MIN",
    "thrust_max": "THR_MAX",
    "thrust_rate_max_per_s": "THR_PER_S",
    "tilt_failsafe_deg": "TILT_FS_DEG",
    "altitude_min_m": "ALT_MIN_M",
    "altitude_max_m": "ALT_MAX_M",
    "tilt_compensation_max_deg": "TILT_CMP_DEG",
    "fence_radius_m": "FENCE_M",
}
_CASCADE = {
    "roll_p": "ROLL_P",
    "pitch_p": "PITCH_P",
    "yaw_p": "YAW_P",
    "altitude_p": "ALT_P",
    "climb_rate_p": "CLIMB_P",
    "climb_rate_i": "CLIMB_I",
}


def tunable_keys(tables: ConfigFile) -> dict[str, Key]:
    """Parameter name -> key, for the parts of a configuration that are flown."""
    control = tables.control
    groups: list[tuple[str, Key, Mapping[str, str]]] = [("ALT", ("control", "altitude"), _ALTITUDE)]
    groups += [(axis.upper(), ("control", control.output, axis), _ANGLE) for axis in ("roll", "pitch", "yaw")]
    groups.append(("REF", ("control",), {"reference_filter_s": "FILTER_S"}))
    if control.controller == "cascaded-pid":
        groups.append(("PID", ("control", "cascade"), _CASCADE))
    if control.controller == "pid":
        groups += [
            ("PID", ("control", "pid", channel), {gain: f"{short}_{gain.upper()}" for gain in "pid"})
            for channel, short in (("roll", "ROLL"), ("pitch", "PITCH"), ("yaw", "YAW"), ("altitude", "ALT"))
        ]
    if tables.position.enabled:
        groups.append(("POS", ("position",), _POSITION))
    groups.append(("LIM", ("limits",), _LIMITS))
    return {
        f"{prefix}_{suffix}": (*table, key)
        for prefix, table, names in groups
        for key, suffix in names.items()
        # A number that may be left out, and is, follows from others; it is no parameter then.
        if _value(tables, (*table, key)) is not None
    }


def _value(tables: BaseModel, key: Key) -> float | None:
    """The number at `key`; None if it is left out or such a table has none."""
    current: Any = tables
    for part in key:
        current = getattr(current, part, None)
    return None if current is None else float(current)


def _tunable(tables: ConfigFile, name: str, key: Key) -> Tunable:
    table: Any = tables
    for part in key[:-1]:
        table = getattr(table, part)
    quantity = quantity_of(type(table).model_fields[key[-1]])
    value = _value(tables, key)
    assert quantity is not None and value is not None
    lower = quantity.above if quantity.above is not None else quantity.at_least
    return Tunable(
        name,
        value,
        -inf if lower is None else lower,
        inf if quantity.at_most is None else quantity.at_most,
        ".".join(key) + (f" [{quantity.unit}]" if quantity.unit else ""),
    )


@dataclass(frozen=True)
class ConfigTuning:
    """The tunables of one configuration file; see `offboard.tuning.Tuning`.

    Attributes
    ----------
    document : the configuration as it was read, command line included, without stored values
    build : makes settings of checked tables
    store : where values are stored; None for nowhere
    values : what differs from `document`
    """

    document: dict[str, Any]
    build: Build
    store: TuningStore | None = None
    values: Mapping[Key, float] = field(default_factory=dict)

    @cached_property
    def tables(self) -> ConfigFile:
        """The checked tables. Raises pydantic's ValidationError."""
        document = copy.deepcopy(self.document)
        for key, value in self.values.items():
            table = document
            for part in key[:-1]:
                table = table.setdefault(part, {})
            table[key[-1]] = value
        return ConfigFile.model_validate(document)

    @cached_property
    def settings(self) -> ServiceSettings:
        """What the service flies with. Raises ValueError if the numbers do not fit each other."""
        return self.build(self.tables)

    @cached_property
    def tunables(self) -> tuple[Tunable, ...]:
        """All parameters, in the order of the tables."""
        return tuple(_tunable(self.tables, name, key) for name, key in self.keys.items())

    @cached_property
    def keys(self) -> dict[str, Key]:
        """Parameter name -> key."""
        return tunable_keys(self.tables)

    @property
    def changes(self) -> dict[str, float]:
        """Parameter name -> value, of those that differ from the configuration."""
        names = {key: name for name, key in self.keys.items()}
        return {names[key]: value for key, value in self.values.items()}

    def with_value(self, name: str, value: float) -> ConfigTuning:
        """See `Tuning.with_value`."""
        if name not in self.keys:
            raise TuningProblem("no such parameter")
        return self._checked({**self.values, self.keys[name]: value})

    def _checked(self, values: Mapping[Key, float]) -> ConfigTuning:
        changed = replace(self, values=dict(values))
        try:
            assert changed.settings is not None  # made and checked here, not in the middle of a step
        except ValidationError as error:
            raise TuningProblem(explain(error, ConfigFile)[0]) from error
        except ValueError as error:
            raise TuningProblem(str(error)) from error
        return changed

    # -------------------------------------------------------------------------- storing

    def stored(self) -> str:
        """See `Tuning.stored`."""
        if self.store is None:
            raise TuningProblem("nowhere to store: no [parameters] file in the configuration")
        self.store.write(as_toml(self.values))
        return f"{len(self.values)} changed parameters stored in {self.store.path.name}"

    def reread(self) -> ConfigTuning:
        """See `Tuning.reread`. Without a file that is the configuration's own values."""
        return self.original() if self.store is None else self._checked(read_values(self.store, self.keys))

    def original(self) -> ConfigTuning:
        """See `Tuning.original`."""
        return replace(self, values={})
