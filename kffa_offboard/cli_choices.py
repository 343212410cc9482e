"""Choices that several commands offer.

Written out, because importing the control law for its names would make --help slow; a test compares them.
"""

from typing import Literal

Controller = Literal["pid", "cascaded-pid", "wb-ladrc", "ladrc", "fa-ladrc", "kffa-ladrc"]
OutputName = Literal["rates", "attitude"]
