"""The sealed benchmark: an independent plant writes recordings with concealed effects, for a diagnosis to find."""
