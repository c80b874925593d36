"""Optional parts of the package, each imported only where it is configured or asked for.

The product, all of the package but this folder, never imports it. Wiring (``commands``, ``cli``,
``ros.nodes``) may; the product asks for what is registered in setup.py by entry points. The folder
can be deleted as a whole.
"""
