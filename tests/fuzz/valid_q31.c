/* Parameters that are valid by construction are accepted, and keep their promises for any samples and calls. */
#include "valid_q31.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    axis_t self;
    valid_q31_t valid;
    input = data;
    input_left = size;

    take_valid(&valid);
    rdpi_status_t status = rdpi_q31_init(&self, &valid.params, valid.sample_time_ns);
    if (status != RDPI_OK) {
        fprintf(stderr, "%d: %s\n", status, rdpi_status_text(status));
    }
    CHECK(status == RDPI_OK);
    call_everything(&self, -0x1p30, 0x1p30);
    return 0;
}
