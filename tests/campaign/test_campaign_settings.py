"""A campaign's file: what it says, and how it says what is wrong."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path

import pytest

from kffa_offboard.campaign.settings import Campaign, CampaignFile, load_campaign
from kffa_offboard.config import ConfigError, bundled
from kffa_offboard.errors import UserError


def written(directory: Path, text: str) -> Path:
    path = directory / "mine.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_the_bundled_file_says_what_is_the_default() -> None:
    assert load_campaign(bundled("campaign.toml")).file == CampaignFile()


@pytest.mark.parametrize(
    ("text", "line"),
    [
        (
            "[random]\nlink_delay_ms = [10, 30]",
            "random.link_delay_ms = (10, 30): unknown key; did you mean link_delay_s?",
        ),
        ("[random]\nload_kg = [5.0, 1.0]", "random.load_kg = (5.0, 1.0): must begin with the lower end"),
        (
            "[random]\nlink_delay_s = [10.0, 30.0]",
            "random.link_delay_s 1 = 10.0: is above 0.2 s; were these milliseconds?",
        ),
        ("[campaign]\nflights = 0", "campaign.flights = 0: must be at least 1"),
        (
            "[failed]\ntilt_max_deg = 0.8",
            "failed.tilt_max_deg = 0.8: is below 3 deg; were these radians?",
        ),
        ('[campaign]\nconfig = "none.toml"', "none.toml: no configuration of that name"),
    ],
)
def test_what_is_wrong_is_one_line(tmp_path: Path, text: str, line: str) -> None:
    with pytest.raises(UserError) as caught:
        load_campaign(written(tmp_path, text))
    assert len([shown for shown in str(caught.value).splitlines() if line in shown]) == 1


def test_the_daemons_own_configuration_is_found_beside_the_file(tmp_path: Path) -> None:
    text = bundled("demo-px4.toml").read_text(encoding="utf-8")
    (tmp_path / "own.toml").write_text(text.replace("attitude_hz = 100", "attitude_hz = 50"))
    path = written(tmp_path, '[campaign]\nconfig = "own.toml"')
    assert load_campaign(path).control_s == pytest.approx(0.02)
    (tmp_path / "own.toml").write_text(text.replace("attitude_hz = 100", "attitude_hz = 125"))
    with pytest.raises(ConfigError, match=r"attitude_hz = 125: a campaign flies 50, 100 or 200 Hz"):
        load_campaign(path)


def test_the_digest_names_all_that_decides_and_not_the_number_of_flights(campaign: Campaign) -> None:
    digest = campaign.digest("kffa-ladrc")

    def changed(table: str, key: str, value: object) -> str:
        tables = getattr(campaign.file, table).model_copy(update={key: value})
        return replace(campaign, file=campaign.file.model_copy(update={table: tables})).digest("kffa-ladrc")

    assert changed("campaign", "flights", 7) == digest
    assert changed("campaign", "seed", 7) != digest
    assert changed("random", "load_kg", (0.0, 1.0)) != digest
    assert pickle.loads(pickle.dumps(campaign)).digest("kffa-ladrc") == digest
    gains = load_campaign(bundled("campaign.toml"), ("ladrc",)).digest("ladrc")
    assert gains != load_campaign(bundled("campaign.toml")).digest("kffa-ladrc")


def test_an_empty_file_is_no_campaign(tmp_path: Path) -> None:
    (tmp_path / "empty.toml").touch()
    with pytest.raises(
        ConfigError, match=r"empty\.toml: holds no key; leave it out for the bundled campaign"
    ):
        load_campaign(tmp_path / "empty.toml")


def test_a_configuration_of_the_daemon_is_called_so_in_one_line() -> None:
    with pytest.raises(ConfigError) as refused:
        load_campaign(bundled("demo-px4.toml"))
    assert len(refused.value.args[0].splitlines()) == 1
    assert "is a configuration of the daemon; name it in a campaign's file as campaign.config" in str(
        refused.value
    )
