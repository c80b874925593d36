"""Plans of minimum time through gates, made ahead by an optimiser (CasADi, the extra ``plan``).

May import simulation (parameters of rotors), references, control (model, config), configuration.
"""
