"""Diagnosis of robots: every joint of a fixed-base tree from one log, by the force that the recorded motion needs."""
