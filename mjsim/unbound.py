"""Channels that a binding does not name: from the default column names, and from words and units in the headers."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

from mjsim.binding import INPUTS, Binding, Channel, plain_channels
from mjsim.readers import Table, guess, guess_control

__all__ = ["by_headers", "completed", "guesses", "without_input"]


def by_headers(binding: Binding, table: Table, *, driven: bool) -> Binding:
    """The binding by the default names, other channels by the words of their headers where time, input and response are found."""
    needed = driven and binding.driven
    channels = plain_channels(table, needed=needed)
    if not binding.driven:
        channels = without_input(channels)
    if all(c.column in table for c in channels.values()) and {"velocity", "angle"} & set(channels):
        return dataclasses.replace(binding, channels=channels)
    there = {role: c for role, c in channels.items() if c.column in table}
    said = {role: Channel(column, unit) for role, (column, unit) in guess(table).items() if role not in there}
    found = there | said
    if not binding.driven:
        found = without_input(found)
    elif needed and not any(role in found for role in INPUTS):
        taken = {c.column for role, c in found.items() if role != "current"}
        control = guess_control([c for c in table if c not in taken])
        if control is not None:
            found = {role: c for role, c in found.items() if c.column != control[0]} | {"control": Channel(*control)}
            said["control"] = found["control"]
    has_input = not needed or any(role in found for role in INPUTS)
    if not (said and "time" in found and has_input and {"velocity", "angle"} & set(found)):
        return dataclasses.replace(binding, channels=channels)
    return dataclasses.replace(binding, channels=found, named=True)


def completed(binding: Binding, table: Table, *, driven: bool) -> Binding:
    """The binding with the time, a response or an input that it does not name, by the default names or by headers."""
    bound, lacking = binding.channels, list[str]()
    if "time" not in bound and not binding.dt:
        lacking.append("time")
    if not {"velocity", "angle"} & set(bound):
        lacking += ["velocity", "angle"]
    if driven and binding.driven and not any(role in bound for role in INPUTS):
        lacking += INPUTS
    if not lacking:
        return binding
    found = by_headers(dataclasses.replace(binding, channels={}, named=False), table, driven=driven).channels
    taken = {c.column for c in bound.values()}
    more = {role: c for role, c in found.items() if role in lacking and c.column in table and c.column not in taken}
    return dataclasses.replace(binding, channels={**bound, **more})


def without_input(channels: Mapping[str, Channel]) -> dict[str, Channel]:
    """The channels without those that can drive a model."""
    return {role: c for role, c in channels.items() if role not in INPUTS}


def guesses(before: Binding, after: Binding) -> list[str]:
    """A note on the columns that were bound by the words of their headers."""
    if before.joints or not after.named:
        return []
    bound = before.channels if before.named else {}
    told = ", ".join(f"{role} = {c.column!r} [{c.unit}]" for role, c in after.channels.items() if c.unit and role not in bound)
    return [f"Columns guessed from their headers: {told}. Bind them in a TOML file to be sure."] if told else []
