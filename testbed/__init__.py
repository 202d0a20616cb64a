"""A virtual force plate under a robot: minimal dynamic parameters, two ways.

What `__init__.pyi` names is promised; it is imported when first used, so that the command line
answers at once.

Source    [FRS96], see REFERENCES.bib
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
