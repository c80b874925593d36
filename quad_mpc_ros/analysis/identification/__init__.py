"""The lags, the delay, the thrust and the drag of a vehicle, fitted to a recorded flight.

``measurements`` takes what is needed from a recording, ``fit`` fits the ``model`` to it, and
``report`` and ``figure`` present it. ``learned`` takes what the controller itself has estimated.
"""
