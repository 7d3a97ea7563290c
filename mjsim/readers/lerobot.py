"""LeRobot data sets, version 2 and 3: Parquet files and ``meta/info.json``; an episode is a recording.

A data set names the dimensions of ``action`` and ``observation.state`` and tells no unit. Where all values of an episode lie
within a turn and a half they are taken as radians, and this is noted; else the columns keep the names ``action.JOINT`` and
``observation.state.JOINT``, to be bound with a unit.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from mjsim.errors import InputError
from mjsim.readers.optional import need
from mjsim.readers.table import Table, need_size

__all__ = ["episodes", "is_lerobot", "read_lerobot"]

INFO = Path("meta") / "info.json"
ROLES = {"observation.state": "angle_rad", "action": "command_rad"}
BOUND = {"command": "action", "angle": "observation.state"}
TAKEN = ": all values lie within a turn and a half and are taken as radians"
MOST_RADIANS = 3 * math.pi  # a turn and a half
MOST_INFO = 2**24  # bytes of meta/info.json


def is_lerobot(folder: Path) -> bool:
    """Whether a folder is a data set."""
    return (folder / INFO).is_file()


def episodes(folder: Path) -> int:
    """Number of episodes of a data set."""
    return int(_info(folder)["total_episodes"])


def read_lerobot(folder: Path, episode: int | None) -> Table:
    """The columns of one episode; one that stands alone need not be named."""
    info = _info(folder)
    count = int(info["total_episodes"])
    if episode is None and count != 1:
        raise InputError(folder, f"it holds {count} episodes", "one that is named", f"{folder}#0 to {folder}#{count - 1}")
    episode = episode or 0
    if not 0 <= episode < count:
        raise InputError(folder, f"no episode {episode}", f"0 to {count - 1}", "name another")
    parquet = need("pyarrow.parquet", folder)
    features = info["features"]
    wanted = [name for name in ROLES if name in features]
    if "observation.state" not in wanted:
        raise InputError(folder, "no feature 'observation.state'", "the position of joints", "record it")
    path = _file(folder, info, episode)
    if not path.resolve().is_relative_to(folder.resolve()):
        raise InputError(folder / INFO, f"data_path leaves the data set ({path})", "a path inside it", "correct it")
    file = parquet.ParquetFile(str(path))
    need_size(path, "the file", 8.0 * file.metadata.num_rows * sum(_width(features[n]) for n in wanted))
    table = file.read(columns=["frame_index", "episode_index", *wanted])
    rows = np.flatnonzero(table.column("episode_index").to_numpy() == episode)
    if not len(rows):
        raise InputError(path, f"no row of episode {episode}", "the rows of an episode", "download the data set again")
    columns = {"time_s": table.column("frame_index").to_numpy()[rows] / float(info["fps"])}
    raw = {name: np.stack(table.column(name).take(rows).to_numpy(zero_copy_only=False)).astype(float) for name in wanted}
    radians = all(np.max(np.abs(values)) <= MOST_RADIANS for values in raw.values())
    for name, values in raw.items():
        for joint, column in zip(_names(features[name], values.shape[1]), values.T, strict=True):
            columns[f"{joint}.{ROLES[name]}" if radians else f"{name}.{joint}"] = column
    notes = (f"Episode {episode} of {count}.", f"The data set states no unit{TAKEN if radians else ''}.")
    return Table.of(columns, notes=notes, hint="" if radians else _hint(folder, columns))


def _hint(folder: Path, columns: Iterable[str]) -> str:
    """What to write for the first joint whose values are no radians."""
    joint = next(c.removeprefix("observation.state.") for c in columns if c.startswith("observation.state."))
    channels = ", ".join(f'{role} = {{ column = "{name}.{joint}", unit = "deg" }}' for role, name in BOUND.items())
    return f"the values are no radians and the data set states no unit: write in {folder.name}.toml, [joints.{joint}] {channels}"


def _info(folder: Path) -> dict[str, Any]:
    path = folder / INFO
    if path.stat().st_size > MOST_INFO:
        raise InputError(path, f"{path.stat().st_size} bytes", f"at most {MOST_INFO}", "download the data set again")
    info = json.loads(path.read_text(encoding="utf-8"))
    lacking = [k for k in ("total_episodes", "fps", "features", "data_path") if k not in info]
    if lacking:
        raise InputError(path, f"no key {lacking[0]!r}", "meta/info.json of LeRobot 2 or 3", "convert the data set")
    return dict(info)


def _file(folder: Path, info: dict[str, Any], episode: int) -> Path:
    """The Parquet file that holds an episode; of version 3 the table of episodes says which."""
    form, size = str(info["data_path"]), int(info.get("chunks_size", 1000))
    if "{episode_index" in form:
        return folder / form.format(episode_chunk=episode // size, episode_index=episode)
    parquet = need("pyarrow.parquet", folder)
    for path in sorted((folder / "meta" / "episodes").rglob("*.parquet")):
        table = parquet.read_table(str(path), columns=["episode_index", "data/chunk_index", "data/file_index"])
        at = np.flatnonzero(table.column("episode_index").to_numpy() == episode)
        if len(at):
            chunk, file = (int(table.column(f"data/{k}_index").to_numpy()[at[0]]) for k in ("chunk", "file"))
            return folder / form.format(chunk_index=chunk, file_index=file)
    raise InputError(folder / "meta" / "episodes", f"no row of episode {episode}", "a row an episode", "download it again")


def _width(feature: dict[str, Any]) -> int:
    return int(np.prod(feature.get("shape", [1])))


def _names(feature: dict[str, Any], count: int) -> list[str]:
    """Names of the dimensions of a feature without the ending ``.pos``; numbers where it names none."""
    names = feature.get("names")
    if isinstance(names, dict):
        names = next(iter(names.values()), None)
    if not isinstance(names, list) or len(names) != count:
        return [str(i) for i in range(count)]
    return [str(n).removesuffix(".pos") for n in names]
