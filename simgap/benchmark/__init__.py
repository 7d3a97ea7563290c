"""The sealed benchmark: an independent plant writes recordings with concealed effects; the diagnosis sees only the files."""
