#pragma once
#include <stdbool.h>
typedef unsigned int uint;
void gpio_put(uint gpio, bool value);
