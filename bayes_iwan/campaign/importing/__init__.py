"""Files of data-acquisition systems into a campaign: text in any layout, LabVIEW, TDMS, UFF 58, MATLAB, Excel, ..."""

from bayes_iwan.campaign.importing.formats.text_layout import Layout
from bayes_iwan.campaign.importing.importer import ImportedTest, import_tests, write_tests
from bayes_iwan.campaign.importing.questions import ImportAsks, Question
from bayes_iwan.campaign.importing.recipe import Recipe, read_recipe

__all__ = ["ImportAsks", "ImportedTest", "Layout", "Question", "Recipe", "import_tests", "read_recipe", "write_tests"]
