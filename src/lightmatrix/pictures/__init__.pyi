from . import maps as maps
from . import relight as relight
from . import style as style
from . import transport as transport
