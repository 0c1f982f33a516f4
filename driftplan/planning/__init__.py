"""Routes of least drift: prices of motions, OMPL's planners and the project's own. The only wing that imports OMPL."""
