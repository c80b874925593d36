"""This controller beside others: the same square, the same weights, one process, one run.

:data:`~quad_mpc_ros.bench.peers.PEERS` lists them, :func:`~quad_mpc_ros.bench.run.run` flies
them in turn, :mod:`~quad_mpc_ros.bench.page` and :mod:`~quad_mpc_ros.bench.picture` show what was
measured. What is foreign (cvxpy, acados) is optional and imported when it is to fly.
"""
