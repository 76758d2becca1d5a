"""The sections of the report, as functions that yield their parts; `contents.SECTIONS` lists them."""
