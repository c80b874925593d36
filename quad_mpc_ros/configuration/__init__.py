# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Parameters as frozen dataclasses, parameter files, and compilation.

Imports nothing else of the package.
"""

from quad_mpc_ros.configuration.errors import (
    ArgumentError,
    BagError,
    ConfigurationError,
    UserError,
)
from quad_mpc_ros.configuration.extension import ExtensibleConfiguration, optional_part, registered
from quad_mpc_ros.configuration.fields import (
    Configuration,
    ManagedConfiguration,
    ParameterSpec,
    PerAxis,
    parameter,
    per_axis,
)

__all__ = [
    "ArgumentError",
    "BagError",
    "Configuration",
    "ConfigurationError",
    "ExtensibleConfiguration",
    "ManagedConfiguration",
    "ParameterSpec",
    "PerAxis",
    "UserError",
    "optional_part",
    "parameter",
    "per_axis",
    "registered",
]
