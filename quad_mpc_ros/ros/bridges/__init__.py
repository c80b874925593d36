"""Bridges to flight stacks: messages and rules of each stack in one file, and one node for all."""
