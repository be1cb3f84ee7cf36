"""Robot Health Monitor: one health monitor for ROS 1, ROS 2 and robots behind rosbridge."""

import os as _os

# An installed copy has core/, ros1/, ros2/ and so on beside this file. In a source tree, a symlink install and a
# catkin devel space they stand one level up, as folders of the repository.
_here = _os.path.dirname(_os.path.realpath(__file__))
if not _os.path.isdir(_os.path.join(_here, "core")):
    __path__.append(_os.path.dirname(_here))
