"""The claims ledger: every claim put to every variant, its verdict, its figures and what it depends on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from lab.study.claims import AGREED, CLAIMS, THRESHOLDS, Claim, Group, Outcome, Reading, Thresholds, Verdict, ask, judge
from lab.study.variants import BASE_BETTER, Variant

__all__ = ["FAMILIES", "Entry", "claims_json", "ledger", "say"]

FAMILIES = {"report": "the report's pipeline", "better": "the better pipeline"}

_UNITS = (("_percent", " %"), ("_hz", " Hz"), ("_db", " dB"), ("_deg", " deg"), ("_real", " rad/s"))


@dataclass(frozen=True)
class Entry:
    """A claim with its answers by variant, the verdict made of them, and the readings (by part) if it speaks of the second peak.

    at_half, at_double: the verdict that half and twice the thresholds would give.
    """

    claim: Claim
    answers: Mapping[Variant, Outcome]
    verdict: Verdict
    shares: Mapping[str, float]
    readings: Mapping[str, Reading]
    at_half: Verdict
    at_double: Verdict

    @property
    def artefact(self) -> bool:
        """Whether the claim, or a part of it, is seen only by extrapolation."""
        return Reading.ARTEFACT in self.readings.values()

    def count(self, family: str) -> tuple[int, int, int]:
        """Variants of a family that meet the criterion, that do not, that cannot say."""
        met = [o.met for v, o in self.answers.items() if v.family == family]
        return met.count(True), met.count(False), met.count(None)

    def parts(self) -> dict[str, dict[str, float]]:
        """Share of the variants that can say in which each part of a compound claim is met, by family."""
        out: dict[str, dict[str, float]] = {}
        for family in FAMILIES:
            said = [o.values for v, o in self.answers.items() if v.family == family and o.met is not None]
            for name in dict.fromkeys(k for values in said for k, x in values.items() if isinstance(x, bool)):
                answers = [values[name] for values in said if name in values]
                out.setdefault(name, {})[family] = sum(answers) / len(answers)
        return out

    def sentence(self) -> str:
        """What the verdict rests on, in words."""
        parts = []
        for family, name in FAMILIES.items():
            yes, no, void = self.count(family)
            if not yes + no:
                parts.append(f"{name}: no variant can say")
                continue
            text = f"{name}: met in {yes} of {yes + no}"
            rare = [v.changed for v, o in self.answers.items() if v.family == family and o.met is (yes < no)]
            if rare and len(rare) <= 8:
                text += f" ({'only' if yes < no else 'not'} with {'; '.join(rare)})"
            parts.append(text + (f", {void} cannot say" if void else ""))
        return ". ".join(p[0].upper() + p[1:] for p in parts) + "."


def _readings(claim: Claim, answers: Mapping[Variant, Outcome], inside: Variant) -> dict[str, Reading]:
    """What a claim about the second peak rests on; of a compound claim, what each part about that peak does."""
    if not claim.second_peak:
        return {}
    parts = {k for o in answers.values() for k, x in o.values.items() if isinstance(x, bool) and "second_peak" in k}
    out = {}
    for part in sorted(parts) or [""]:
        met = {v: o.values.get(part) if part and o.met is not None else o.met for v, o in answers.items()}
        outside = [m for v, m in met.items() if m is not None and (v.family == "report" or v.experiment.high_hz < 40)]
        if met[inside]:
            out[part] = Reading.PHYSICS
        else:
            out[part] = Reading.ARTEFACT if outside and sum(outside) > (1 - AGREED) * len(outside) else Reading.ABSENT
    return out


def ledger(groups: Mapping[Variant, Group], claims: Sequence[Claim] = CLAIMS, inside: Variant = BASE_BETTER) -> tuple[Entry, ...]:
    """Put every claim to every variant; ``inside``: where the second peak is excited and well placed."""
    out = []
    for claim in claims:
        answers, (verdict, shares) = _asked(claim, groups, THRESHOLDS)
        half, double = (_asked(claim, groups, THRESHOLDS.times(f))[1][0] for f in (0.5, 2.0))
        out.append(Entry(claim, answers, verdict, shares, _readings(claim, answers, inside), half, double))
    return tuple(out)


def _asked(
    claim: Claim, groups: Mapping[Variant, Group], thresholds: Thresholds
) -> tuple[dict[Variant, Outcome], tuple[Verdict, dict[str, float]]]:
    answers = {v: ask(claim, g, thresholds) for v, g in groups.items()}
    return answers, judge({f: [o.met for v, o in answers.items() if v.family == f] for f in FAMILIES})


def say(values: Mapping[str, Any]) -> str:
    """Values as a line of text with their units."""
    parts = []
    for key, value in values.items():
        name, unit = key, ""
        for suffix, shown in _UNITS:
            if key.endswith(suffix):
                name, unit = key.removesuffix(suffix), shown
        name = name.replace("_", " ")
        if isinstance(value, bool):
            text = f"{name}: {'yes' if value else 'no'}"
        elif isinstance(value, float):
            text = f"{name} {value:+.2f}{unit}" if unit in (" %",) else f"{name} {value:.2f}{unit}"
        elif isinstance(value, list | tuple):
            text = f"{name}: {', '.join(map(str, value)).replace('_', ' ') or 'none'}"
        else:
            text = f"{name}: {'none' if value is None else value}"
        parts.append(text)
    return "; ".join(parts)


def claims_json(entries: Sequence[Entry], extra: Mapping[str, Mapping[str, Any]] | None = None) -> list[dict[str, Any]]:
    """``claims.json``: id, verdict, criterion, values, and how they came about; ``extra`` adds values by claim."""
    out = []
    for e in entries:
        values: dict[str, Any] = {}
        for v, o in e.answers.items():
            if v.changed == "base":
                values[v.family] = dict(o.values)
        values |= {k: dict(v) if isinstance(v, Mapping) else v for k, v in (extra or {}).get(e.claim.id, {}).items()}
        out.append(
            {
                "id": e.claim.id,
                "claim": e.claim.text,
                "verdict": e.verdict.value,
                "criterion": e.claim.criterion,
                "values": values,
                "share_met": {k: round(s, 3) for k, s in e.shares.items()},
                "verdict_at_half_thresholds": e.at_half.value,
                "verdict_at_double_thresholds": e.at_double.value,
                "parts_met": {k: {f: round(s, 3) for f, s in p.items()} for k, p in e.parts().items()},
                "about_second_peak": e.claim.second_peak,
                "second_peak_readings": {part or "claim": r.name.lower() for part, r in e.readings.items()},
                "extrapolation_artefact": e.artefact,
                "basis": e.sentence(),
                "map": [{"family": v.family, "variant": v.changed, "met": o.met} for v, o in e.answers.items()],
            }
        )
    return out
