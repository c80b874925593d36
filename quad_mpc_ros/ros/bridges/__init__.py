"""Flight stacks: the messages and rules of each in one file, and the node that wires any."""
