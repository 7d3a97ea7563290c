"""``python -m lab.unknown_physics --seed 1 --out out/unknown``: each kind of physics in each form of log, diagnosed."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from scipy.stats import binomtest

from diagnose.options import Options
from lab.unknown_physics.machines import FORMS, KINDS, write_case
from mjsim.effects.registry import registered
from mjsim.errors import InputError
from simgap.pipeline import diagnose_files

DRY = {name for name, effect in registered().items() if effect.family == "friction"}
FRICTION = DRY | {name for name, effect in registered().items() if DRY & set(effect.refines)}
"""Laws of dry friction, and laws that contain one."""
CLEAR = ("no_mismatch", "parameters_only")
NAMED = "missing_physics"


def main() -> None:
    """Diagnose all cases and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--form", choices=FORMS, help="This form of log only.")
    parser.add_argument("--friction", action="store_true", help="Coulomb friction acts as well, and the model lacks it.")
    asked = parser.parse_args()
    counts = {"false all-clear": 0, "missing physics, named": 0, "unexplained": 0, "refused": 0}
    print("| physics | log | verdict | named | held-out error, nominal | corrected |\n|---|---|---|---|---|---|")
    named = 0
    cases = [(kind, form) for forms in (FORMS[:3], FORMS[3:]) for kind in KINDS for form in forms if asked.form in (None, form)]
    for index, (kind, form) in enumerate(cases):
        folder = asked.out / f"{index:02d}_{kind}_{form}"
        write_case(kind, form, 1000 * asked.seed + index, folder, asked.friction)
        try:
            logs = folder / "fitted.csv", folder / "held_out.csv"
            options = Options(jobs=asked.jobs)
            diagnose_files(logs[:1], folder / "model.xml", folder / "out", logs[1:], options, progress=False, accept_log=True)
        except InputError as error:
            counts["refused"] += 1
            print(f"| {kind} | {form} | refused: {error} | | | |")
            continue
        said = json.loads((folder / "out" / "diagnosis.json").read_text(encoding="utf-8"))
        verdict, fit = said["verdict"], said["fit"]
        names = ", ".join(f["effect"] for f in said["findings"])
        named += bool(FRICTION & {f["effect"] for f in said["findings"]})
        counts["false all-clear" if verdict in CLEAR else "missing physics, named" if verdict == NAMED else "unexplained"] += 1
        print(f"| {kind} | {form} | {verdict} | {names} | {fit['nominal']['held_out_rms']:.3g} | "
              f"{fit['corrected']['held_out_rms']:.3g} |", flush=True)  # fmt: skip
    if asked.friction:
        counts["friction named"] = named
    for what, count in counts.items():
        within = binomtest(count, len(cases)).proportion_ci(method="wilson")
        print(f"{what}: {count} of {len(cases)} (95 %: {100 * within.low:.1f} to {100 * within.high:.1f} %)")


if __name__ == "__main__":
    main()
