"""The optimal control problem: the two formulations, the sparse QP, and OSQP."""
