"""The tables of a configuration about the link: where it is, how it is signed, whom it obeys."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, Field, field_validator, model_validator

from kffa_offboard.config_control import Table
from kffa_offboard.errors import UserError
from kffa_offboard.mavlink.address import parse_url
from kffa_offboard.mavlink.senders import parse_sender

SystemId = Annotated[int, Field(ge=1, le=255)]
ComponentId = Annotated[int, Field(ge=1, le=255)]


def _expands(name: str) -> str:
    if not name:
        raise ValueError("no file has such a name; leave the key out for none")
    try:
        Path(name).expanduser()
    except RuntimeError as error:
        raise ValueError("nobody of that name has a home directory; write the whole path") from error
    if "\0" in name:
        raise ValueError("no file has such a name; write another one")
    return name


FileName = Annotated[str, AfterValidator(_expands)]
"""Of a file or a directory; may begin with ~."""


class LinkTable(Table):
    """`[link]`: where the vehicle is, and who we are on the MAVLink network."""

    url: str = Field(
        description='where the vehicle is: "udpin:127.0.0.1:14540", "serial:/dev/ttyUSB0:921600", ...'
    )
    allow_remote: bool = False
    system_id: SystemId = 245
    component_id: ComponentId = 191
    target_system: SystemId = 1
    target_component: ComponentId = 1

    @field_validator("url")
    @classmethod
    def _can_be_read(cls, url: str) -> str:
        try:
            parse_url(url)
        except UserError as error:
            raise ValueError(str(error).partition(": ")[2]) from error
        return url

    @model_validator(mode="after")
    def _is_not_the_vehicle(self) -> LinkTable:
        ids = (self.system_id, self.component_id)
        if ids == (self.target_system, self.target_component):
            raise ValueError(
                f"system_id = {ids[0]}, component_id = {ids[1]}: are those of the vehicle (target_system, "
                "target_component), whose messages would be taken for our own; leave component_id at 191"
            )
        return self


class SigningTable(Table):
    """`[signing]`: MAVLink 2 signing, off without `key_file`.

    Files are named from the configuration's directory. See docs/security.md.
    """

    key_file: FileName | None = None
    link_id: Annotated[int, Field(ge=0, le=255)] = 0
    timestamp_file: FileName | None = None

    @model_validator(mode="after")
    def _all_need_a_key(self) -> SigningTable:
        if self.timestamp_file is not None and self.key_file is None:
            raise ValueError("timestamp_file is of no use without key_file; give both or none")
        return self


class CompanionTable(Table):
    """`[companion]`: who may command the daemon, set its parameters and send it setpoints.

    "SYSTEM" or "SYSTEM/COMPONENT"; left out, everybody on the link.
    """

    allow: list[str] | None = None

    @field_validator("allow")
    @classmethod
    def _are_senders(cls, allow: list[str] | None) -> list[str] | None:
        for text in allow or []:
            if parse_sender(text) is None:
                raise ValueError(f'"{text}" is no sender; write "255" or "255/190", numbers from 1 to 255')
        return allow
