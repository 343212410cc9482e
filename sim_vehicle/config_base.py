"""What all sections of the configuration have in common."""

from __future__ import annotations

from typing import Annotated, TypeAlias

from pydantic import BaseModel, ConfigDict, Field

NotNegative: TypeAlias = Annotated[float, Field(ge=0.0)]


class Section(BaseModel):
    """Common rules: no unknown keys, no conversions from text, no NaN, values do not change."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)
