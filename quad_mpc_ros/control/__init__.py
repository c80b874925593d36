"""The controller; :mod:`.controller` is where to begin to read."""
