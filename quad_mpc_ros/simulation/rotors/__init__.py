"""The plant ``rotors``: rotors, body, battery and rate loop of a real vehicle.

Throttle and body rates go in as an autopilot takes them. The rate loop wants a torque, the mixer
shares thrust and torque among the rotors, the rotors follow with their lag, the body moves.
"""
