"""This controller beside others: the same square, the same weights, one process, one run.

:data:`.peers.PEERS` lists them, :func:`.run.run` flies them in turn, :mod:`.page` and
:mod:`.picture` show what was measured. What is foreign (cvxpy, acados) is optional and imported
when it is to fly.
"""
