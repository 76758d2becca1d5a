"""Functions that yield the parts of the report's sections; `contents.SECTIONS` lists them."""
