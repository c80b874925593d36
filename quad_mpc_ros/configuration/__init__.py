"""Parameters: declared once as frozen dataclasses, validated everywhere the same way."""

from quad_mpc_ros.configuration.errors import BagError, ConfigurationError, UserError
from quad_mpc_ros.configuration.extension import ExtensibleConfiguration, registered
from quad_mpc_ros.configuration.fields import (
    Configuration,
    ManagedConfiguration,
    ParameterSpec,
    PerAxis,
    parameter,
    per_axis,
)

__all__ = [
    "BagError",
    "Configuration",
    "ConfigurationError",
    "ExtensibleConfiguration",
    "ManagedConfiguration",
    "ParameterSpec",
    "PerAxis",
    "UserError",
    "parameter",
    "per_axis",
    "registered",
]
