"""Diagnosis of robots from commands and positions: each joint runs under its own servo while the others follow the recording."""
