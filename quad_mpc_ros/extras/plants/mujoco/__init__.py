"""The plant ``mujoco``: rotors, body and rate loop of the plant ``rotors`` among things to touch.

MuJoCo moves the body and says what ground, deck, walls, landing gear and a load on a cable do to
it (E. Todorov, T. Erez, Y. Tassa, "MuJoCo: A physics engine for model-based control", 2012).
"""
