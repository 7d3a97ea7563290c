"""Robots: fixed-base trees of hinges and slides, their recordings, and their inverse dynamics along a motion."""
