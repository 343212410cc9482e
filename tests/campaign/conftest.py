"""A campaign that is too short to mean anything, for what does not depend on its length."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from kffa_offboard.campaign.settings import Campaign, CampaignFile, load_campaign
from kffa_offboard.config import bundled
from kffa_offboard.control.controllers import ControllerName

SHORT = {
    "flight": {"settle_s": 0.5},
    "random": {"drop_after_s": [0.4, 0.8]},
    "failed": {"recovery_max_s": 0.6},
}


Shortened = Callable[..., Campaign]


def _shortened(tables: dict[str, dict[str, object]], *controllers: ControllerName) -> Campaign:
    """The bundled campaign with other values."""
    told = load_campaign(bundled("campaign.toml"), controllers)
    document = told.file.model_dump(mode="json")
    merged = {name: {**document[name], **SHORT.get(name, {}), **tables.get(name, {})} for name in document}
    return replace(told, file=CampaignFile.model_validate(merged))


@pytest.fixture(scope="session")
def shortened() -> Shortened:
    """Called with tables of other values and the controllers that fly."""
    return _shortened


@pytest.fixture(scope="session")
def campaign() -> Campaign:
    return _shortened({}, "kffa-ladrc")
