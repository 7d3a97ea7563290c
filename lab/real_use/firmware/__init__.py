"""Machines of plain MuJoCo under drives written in Python, diagnosed against MJCF files whose servos are ``<position>``.

The drives share no code with `mjsim`: position loops at 1 kHz with what the firmware of servos and industrial drives has
(profiles, dead bands, latency, limits of torque and of torque over speed, integral action, feedforward). Frictions and springs
that MJCF lacks act as applied forces.

python -m lab.real_use.firmware run --seed 7 --count 40 --out out/firmware/7.jsonl     # resumable, one JSON line a case
python -m lab.real_use.firmware table out/firmware/7.jsonl --into docs/real_use.md
"""
