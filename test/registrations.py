"""Takes back what a test registers: shapes, elements, actuators and channels."""

from contextlib import contextmanager

from softrobot_twin.mechanics import element_kinds
from softrobot_twin.scene import schema
from softrobot_twin.scene.entry import forms_of
from softrobot_twin.simulation.building import actuator_kinds
from softrobot_twin.tables import channels


@contextmanager
def taken_back():
    """What is registered inside is known no more afterwards; scenes that name it are refused again."""
    models = (*schema.SHAPED_ENTRIES, schema.Scene)
    fields = [set(model.model_fields) for model in models]
    lists = [(one, len(one)) for one in (channels.REGISTERED_CHANNELS, actuator_kinds.ACTUATOR_KINDS)]
    tables = [(one, set(one)) for one in (element_kinds.ELEMENT_KINDS, schema.ACTUATOR_SECTIONS)]
    shapes = schema.Shaped.one_of
    try:
        yield
    finally:
        for one, count in lists:
            del one[count:]
        for model, names in zip(models, fields, strict=True):
            tables += [(model.model_fields, names), (model.__annotations__, names)]
        for one, keys in tables:
            for key in one.keys() - keys:
                del one[key]
        schema.Shaped.one_of = shapes
        forms_of.cache_clear()
        for model in models:
            model.model_rebuild(force=True)
