"""The page on which a layout can be looked at and changed: what a browser is given.

scene       what the page is about, as JSON; the page as one file

The page itself is plain JavaScript beside these files: ``moments.js``, ``elements.js``, ``estimators.js``,
``passes.js``, ``drift.js`` and ``calculator.js`` are the drift model again, tested against Python; the others draw and
edit.
"""
