"""From a scene to a model: bodies, actuators, terms and rows. Nothing here steps."""
