from . import choice as choice
from . import corrected as corrected
from . import estimate as estimate
