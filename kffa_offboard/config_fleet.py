"""Several configurations for several vehicles in one process."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from kffa_offboard.config import ConfigError, DaemonConfig, Overrides, load
from kffa_offboard.errors import UserError


def load_fleet(paths: Sequence[Path], overrides: Overrides) -> dict[str, DaemonConfig]:
    """Configurations by name: that of the file, without its ending. Raises UserError with all problems.

    Beside the problems of each: two vehicles with one name, on one link, or with one system id and one
    directory (files there are named by the id); a tcp link (connecting would keep the others waiting).
    """
    if len(paths) == 1:
        return {paths[0].stem: load(paths[0], overrides)}
    problems: list[str] = []
    fleet: dict[str, DaemonConfig] = {}
    urls: dict[str, str] = {}
    files: dict[tuple[Path | None, int], str] = {}
    for path in paths:
        try:
            config = load(path, overrides)
        except ConfigError as error:
            problems += str(error).splitlines()
            continue
        name, url = path.stem, config.link.url
        place = config.log.directory, config.link.target_system
        if name in fleet:
            problems.append(f"{path}: another vehicle is called {name!r}, too; rename the file")
        elif url in urls and not url.endswith(":0"):
            problems.append(f"{path}: link.url = {url!r}: {urls[url]!r} has it already; one vehicle a link")
        elif url.startswith("tcp:"):
            problems.append(f"{path}: link.url = {url!r}: several vehicles need udp, serial or tcpin links")
        elif place in files:
            problems.append(
                f"{path}: link.target_system = {place[1]}: {files[place]!r} has it, too; "
                "give each a log.directory of its own"
            )
        fleet[name], urls[url], files[place] = config, name, name
    if problems:
        raise UserError("\n".join(problems))
    return fleet
