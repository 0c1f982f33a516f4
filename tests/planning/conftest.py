"""What tests of planning share."""

import pytest
from ompl import util as ou


@pytest.fixture
def quiet():
    """OMPL says nothing meanwhile."""
    level = ou.getLogLevel()
    ou.setLogLevel(ou.LOG_NONE)
    yield
    ou.setLogLevel(level)
