"""Who commands the vehicle, whatever happens; :mod:`.supervisor` is where to begin to read."""
