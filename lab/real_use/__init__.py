"""Logs of plain MuJoCo models as users have them, diagnosed: false alarms, effects named right, corrected files judged."""
