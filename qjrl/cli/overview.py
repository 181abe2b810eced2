"""What ``qjrl --help`` says."""

from qjrl import __version__, pipeline
from qjrl.config import conf_folder, read_yaml

_TEXT = """\
qjrl {version}: the toolkit for cable-driven arms made of quaternion joints

  qjrl [stages=[...]] [GROUP=CHOICE] [+experiment=NAME] [KEY=VALUE ...] [-m]

Pipeline: the stages that run when none are asked for; each writes to outputs/NAME/DIRECTORY
{pipeline}
Tools for your own arm (stages=[...])
{tools}
Studies: experiments, with their figures and tables (stages=[...])
{studies}
Groups (* is the default)
{groups}
Values
  qjrl --cfg job          prints every key with its value; keys are dotted: sample.num_samples=4096
  name=NAME seed=INTEGER  name of the directory under outputs/, seed of everything random

Examples
  qjrl                                           the whole pipeline at the size of a small computer
  qjrl +experiment=smoke                         the whole pipeline in a minute or so, to see it work
  qjrl stages=[sample,forward_model] sample.num_samples=4096
  qjrl stages=[describe] robot=my_arm.yaml       your own arm, from your own file
  qjrl -m seed=1,2 forward_model=paper,corrected +experiment=smoke hydra/launcher=joblib

The same command again skips what is done and goes on where it was interrupted.
"""


def overview() -> str:
    """Stages, groups, values and examples."""
    stages, width = {"pipeline": "", "tools": "", "studies": ""}, max(map(len, pipeline.STAGES))
    for name, stage in pipeline.STAGES.items():
        stages[stage.group] += f"  {name:<{width}} {stage.summary} ({stage.writes}/)\n"
    return _TEXT.format(version=__version__, groups=_groups(), **stages)


def _groups() -> str:
    defaults = {group: choice for entry in read_yaml(conf_folder() / "config.yaml")["defaults"]
                if isinstance(entry, dict) for group, choice in entry.items()}  # fmt: skip
    text = ""
    for folder in sorted(path for path in conf_folder().iterdir() if path.is_dir()):
        choices = [path.stem + "*" * (defaults.get(folder.name) == path.stem) for path in sorted(folder.glob("*.yaml"))]
        name = "+experiment" if folder.name == "experiment" else folder.name
        own = ", or a file: robot=my_arm.yaml" if folder.name == "robot" else ""
        text += f"  {name:<15} {', '.join(choices)}{own}\n"
    return text
