"""How much a configuration bears before a disturbed vehicle does not come back to its hover.

:func:`.rehearsal.rehearse` flies and searches, :mod:`.verdict` says what it means,
:mod:`.figure` draws it.
"""
