"""The plant ``rotors``: rotors, body, battery and rate loop of a real vehicle.

Its inputs are throttle and body rates, as an autopilot takes them. The rate loop asks for a
torque, the mixer allocates thrust and torque to the rotors, which follow with their lag.
"""
