"""Files of data-acquisition systems into a campaign: text in any layout, NI TDMS, UFF 58, MATLAB, Parquet."""

from bayes_iwan.campaign.importing.recipe import Recipe, read_recipe
from bayes_iwan.campaign.importing.run import ImportedTest, import_tests, write_tests
from bayes_iwan.campaign.importing.text import Layout

__all__ = ["ImportedTest", "Layout", "Recipe", "import_tests", "read_recipe", "write_tests"]
