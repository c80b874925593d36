"""Margins of a configuration: model errors from which a disturbed vehicle still recovers.

:func:`.rehearsal.rehearse` flies and searches the limits, :mod:`.verdict` evaluates the limits.
"""
