"""Parameters: declared once as frozen dataclasses, validated everywhere the same way."""

from quad_mpc_ros.configuration.errors import BagError, ConfigurationError, UserError
from quad_mpc_ros.configuration.extension import ExtensibleConfiguration, registered
from quad_mpc_ros.configuration.fields import (
    Configuration,
    ManagedConfiguration,
    ParameterSpec,
    parameter,
)

__all__ = [
    "BagError",
    "Configuration",
    "ConfigurationError",
    "ExtensibleConfiguration",
    "ManagedConfiguration",
    "ParameterSpec",
    "UserError",
    "parameter",
    "registered",
]
