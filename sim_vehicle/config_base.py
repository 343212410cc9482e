"""What all sections of the configuration have in common."""

from __future__ import annotations

from typing import Annotated, TypeAlias

from pydantic import BaseModel, ConfigDict, Field

NotNegative: TypeAlias = Annotated[float, Field(ge=0.0, le=1e6)]
Noise: TypeAlias = Annotated[float, Field(ge=0.0, le=1000.0)]
Number: TypeAlias = Annotated[float, Field(ge=-1000.0, le=1000.0)]
"""Far beyond anything that flies; what is larger overflows sooner or later."""


class Section(BaseModel):
    """Common rules: no unknown keys, no conversions from text, no NaN, values do not change."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)
