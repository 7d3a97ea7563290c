"""Whether a model predicts recordings worse than a baseline diagnosis says: of an axis (`axis`), or of a robot (`robot`)."""
