"""How Sphinx makes a site of README, the pages in docs/ and the notebooks: `make docs`, in the repository's folder."""

from importlib.metadata import version as version_of

project = "jaxgrity"
copyright = "the authors of jaxgrity, Apache-2.0"
release = version = version_of("jaxgrity")
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.autosummary", "docs.site.equations", "docs.site.interface"]

# The repository is the source folder, so that links between pages lead to the same files here as on a code host.
root_doc = "docs/index"
include_patterns = ["README.md", "CONTRIBUTING.md", "CHANGELOG.md", "docs/**", "notebooks/*.ipynb"]
exclude_patterns = [".*", "build", "dist", "results", "jaxgrity", "experiments", "tests", "docs/measured"]
highlight_language = "none"

myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3
nb_execution_mode = "off"

autodoc_member_order = "bysource"
python_use_unqualified_type_names = True
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"
autosummary_generate = False
default_role = "code"
add_module_names = False
toc_object_entries_show_parents = "hide"

html_theme = "furo"
html_title = "jaxgrity"
html_static_path = ["site/static"]
html_css_files = ["site.css"]
html_extra_path = ["site/redirect"]
html_math_renderer = "mathml"
html_copy_source = False
html_show_sphinx = False
