"""MCAP logs with messages in JSON, in Protobuf, or of ROS 2 (CDR), with the definitions that the file brings.

Definitions are interpreted, not run.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from mjsim.errors import InputError
from mjsim.readers.optional import need
from mjsim.readers.table import Table
from mjsim.readers.topics import Topics, kind_of

__all__ = ["read_mcap"]


def read_mcap(path: Path) -> Table:
    """As `mjsim.readers.topics.Topics` makes columns of it; a topic in another encoding is left out.

    The type of a message in JSON or Protobuf follows from its fields. Raises InputError where no topic can be read.
    """
    reader = need("mcap.reader", path)
    topics = Topics(path)
    decoders: dict[int, Callable[[bytes], Any] | None] = {}
    read = False
    with path.open("rb") as handle:
        for schema, channel, message in reader.make_reader(handle, validate_crcs=True).iter_messages():
            if channel.id not in decoders:
                decoders[channel.id] = _decoder(path, channel.message_encoding, schema)
            decode = decoders[channel.id]
            if decode is None:
                topics.leave_out(channel.topic, f"messages encoded as {channel.message_encoding!r}")
                continue
            read, told = True, decode(message.data)
            kind = schema.name if channel.message_encoding == "cdr" else kind_of(told)
            topics.add(channel.topic, kind, message.log_time, told)
    if decoders and not read:
        raise InputError(
            path, f"no topic can be read ({topics.left_out})", "messages in JSON, Protobuf or of ROS 2 (CDR)",
            "record or convert it so, or to CSV",
        )  # fmt: skip
    return topics.table()


def _decoder(path: Path, encoding: str, schema: Any) -> Callable[[bytes], Any] | None:
    """What makes mappings or objects of the messages of a channel; None for an encoding that is not read."""
    if encoding == "json":
        return json.loads
    if encoding == "cdr":
        decode: Callable[[bytes], Any] | None = need("mcap_ros2.decoder", path).DecoderFactory().decoder_for(encoding, schema)
        return decode
    if encoding == "protobuf":
        parse = need("mcap_protobuf.decoder", path).DecoderFactory().decoder_for(encoding, schema)
        return None if parse is None else lambda data: _fields(parse(data))
    return None


def _fields(message: Any) -> dict[str, Any]:
    """The fields of a Protobuf message by name; one that has not been set and says so is left out."""
    out: dict[str, Any] = {}
    for field in message.DESCRIPTOR.fields:
        value = getattr(message, field.name)
        if field.is_repeated:
            if field.message_type is None:
                out[field.name] = list(value)
            elif not field.message_type.GetOptions().map_entry:
                out[field.name] = [_fields(item) for item in value]
            continue
        if field.has_presence and not message.HasField(field.name):
            continue
        out[field.name] = value if field.message_type is None else _fields(value)
    return out
