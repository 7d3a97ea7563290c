"""Keys of the JSON files that commands write, in words; `tests/test_json_keys.py` holds them against files that are written."""

from __future__ import annotations

__all__ = ["FILES"]

ERRORS = "of a model file: rms, nrmse (rms over the spread of the measurement), held_out_rms, held_out_nrmse, ahead"
FILES: dict[str, tuple[str, dict[str, str]]] = {
    "diagnosis.json": (
        "Written by `simgap diagnose`; `Diagnosis.as_dict()`.",
        {
            "verdict": "no_mismatch, parameters_only, missing_physics or unexplained",
            "summary": "the answer in a sentence or two",
            "findings": "list of effects, strongest first",
            "findings[].effect": "identifier, as `simgap effects` lists them",
            "findings[].class": "physics, or numerics where a setting of the simulator makes the difference",
            "findings[].law": "identifier of the law that was fitted, where the effect has several",
            "findings[].place": "motor, gearbox, arm, actuator or sensor",
            "findings[].element": "name of the MJCF element",
            "findings[].sentence": "the finding in words",
            "findings[].parameters": "by name: value, ci95 (low, high), unit",
            "findings[].evidence": "held_out_error_before, held_out_error_after, p_value, delta_chi2, hypotheses",
            "findings[].equivalents": "effects that the data do not tell from it, lowest held-out error first",
            "findings[].equivalent_errors": "their held-out rms errors, by name",
            "mismatch": "where it is: time, frequency, state: intervals with their share of the residual; recordings: of each",
            "linear_parameters": "the model's own numbers as fitted: value, ci95, unit",
            "nominal_parameters": "the same as given",
            "nominal_effects": "effects that the model has itself, as given and as fitted",
            "log": "what the check of the recordings found: verdict, problems; null for a servo",
            "fit": "errors by model: nominal, refitted, corrected, surrogate (the fitting engine's), noise_floor",
            "fit.nominal": ERRORS,
            "gap_closed": "part of the error above the noise that the correction removes",
            "map": "a torque map of what no effect explains, or null",
            "judged_on": "channel, unit and view (motion or force) of the comparison",
            "rivals": "structures that were fitted, with their errors",
            "refusals": "leading rivals, the test that refused each, and by how much",
            "notes": "what was assumed, guessed or not done",
            "next_experiment": "what to record next, or null",
            "seed": "of the random generators",
            "versions": "of simgap and what it runs on",
            "recordings": "file, sha256, role and hold of the input of each",
            "seconds": "how long it took",
        },
    ),
    "diagnosis.json of a robot": (
        "As above, with findings by joint.",
        {
            "findings[].joint": "name of the joint",
            "joints": "by name: verdict, summary, findings, fit, linear_parameters, remains, refusals",
            "base_parameters": "combinations of inertial parameters that the motion determines, given and fitted",
            "changed": "in words, what of the robot's own numbers differs from the file",
        },
    ),
    "check.json": (
        "Written by `simgap check --out`; `LogCheck.as_dict()`.",
        {
            "verdict": "ready, limits or fix",
            "problems": "list: channel, problem, value, unit, sentence, advice, severity, ci95, recording",
            "understood": "topic and sentence: what was understood of model and log",
            "excitation": "families of effects, whether the excitation shows them, and why",
            "measured": "of each recording the estimates that the checks rest on",
        },
    ),
    "identification.json": (
        "Written by `simgap identify`; `Identification.as_dict()`.",
        {
            "structure": "bj",
            "orders": "nb, nc, nd, nf, nk",
            "dt": "sampling interval after decimation [s]",
            "B": "coefficients, from q^-nk on",
            "C": "monic polynomial in q^-1",
            "D": "monic polynomial in q^-1",
            "F": "monic polynomial in q^-1",
            "noise_variance": "of the white noise",
            "std": "standard errors of the coefficients",
            "fit_percent": "of the one-step prediction",
            "fpe": "final prediction error",
            "aic": "Akaike's criterion",
            "bic": "Schwarz's criterion",
            "residual_tests": "whiteness and independence of the input",
            "bode": "frequency_hz, magnitude_db, phase_deg, magnitude_db_ci95",
            "verdict": "grade and sentences",
            "preprocessing": "what was done to the channels",
        },
    ),
}
"""File -> what writes it, and its keys in words."""
