"""This controller beside others: the same square, the same weights, one process, one run.

:mod:`.peers` says what a peer is, :func:`.run.run` flies them in turn, :mod:`.page` and
:mod:`.picture` show what was measured. Foreign peers are files of their own: ``bench/peers``.
"""
