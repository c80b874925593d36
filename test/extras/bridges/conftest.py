"""Messages of the stacks, and bridges as processes of their own."""

from fixtures.bridge_nodes import matching, new, sound, start

__all__ = ["matching", "new", "sound", "start"]
