"""Headless pictures of an axis in motion: what is shown (`stage`), written on it (`overlay`), and how it is filmed (`film`)."""

from mjsim.render.film import Shot, film, shot_of_recording, shot_of_run

__all__ = ["Shot", "film", "shot_of_recording", "shot_of_run"]
