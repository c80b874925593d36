"""Parameters: declared once as frozen dataclasses, validated everywhere the same way."""

from quad_mpc_ros.configuration.fields import (
    Configuration,
    ConfigurationError,
    ParameterSpec,
    parameter,
)

__all__ = ["Configuration", "ConfigurationError", "ParameterSpec", "parameter"]
