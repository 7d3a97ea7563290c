"""Headless films: a user's own model (`scene`, `take`, `own`), or the magnified axis (`stage`, `film`)."""

from mjsim.render.film import Shot, film, shot_of_recording, shot_of_run
from mjsim.render.own import Style, film_takes
from mjsim.render.scene import Scene
from mjsim.render.take import Rig, Take

__all__ = ["Rig", "Scene", "Shot", "Style", "Take", "film", "film_takes", "shot_of_recording", "shot_of_run"]
