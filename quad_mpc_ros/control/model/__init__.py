"""The vehicle: state, parameters, samples, and the model that predicts it."""
