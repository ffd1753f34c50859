"""How results are told: on a terminal, in pictures, in the report of a demo."""
