"""``quad_mpc soak``: does the controller hold, for long and whatever fails?"""
