"""Concealed robots: a plant of its own, cases, and the score of their diagnoses; the model of a real robot."""
