/* Images that must not pass, one for each value of BROKEN. ../CMakeLists.txt lets a CTest of their own say that they do
 * not. */
#include "unity.h"

void setUp(void)
{
}

void tearDown(void)
{
}

static void test_fails(void)
{
    TEST_ASSERT_EQUAL_INT(1, 2);
}

static void test_hangs(void)
{
    for (volatile int turns = 0;; turns = 1) {
    }
}

static void test_faults(void)
{
    __builtin_trap();
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(BROKEN);
    return UNITY_END();
}
