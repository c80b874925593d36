"""Many flights of the closed loop that differ in some parameters, and tuning by them."""
