import Sofa.Core


class CableKeys(Sofa.Core.Controller):
    def __init__(self, *given, **named):
        Sofa.Core.Controller.__init__(self, *given, **named)
        self.cable = named["node"].flexor

    def onKeypressedEvent(self, event):
        self.cable.value = [self.cable.value[0] + 1.0]
