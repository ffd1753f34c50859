"""Notes which kernels are compiled, or loaded, from some time on."""

from numba.core.dispatcher import Dispatcher


def noted(replace=setattr):
    """Their names; the list grows.

    Args:
        replace: Puts the function that notes them in place of the dispatcher's.
    """
    found, compiled = [], Dispatcher.compile

    def note(self, signature):
        # Numba asks again for what it has where only the strides of an array are new.
        found.extend([self.py_func.__qualname__] if signature not in self.overloads else [])
        return compiled(self, signature)

    replace(Dispatcher, "compile", note)
    return found
