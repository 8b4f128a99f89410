from tests.env.conftest import make_task as make_task
from tests.env.conftest import own_words as own_words
