"""Time-optimal plans through gates, computed before the flight (CasADi, the extra ``plan``).

May import simulation (parameters of rotors), references, control (model, config), configuration.
"""
