/* ESP32-C3 (RISC-V, rv32imc), ESP-IDF 5: a timer wakes a task, and an AD5683R (16 bits) is on the SPI. Your app_main
 * adds the device to its SPI bus (mode 1) and calls run_axis. */
#include "driver/gptimer.h"
#include "driver/spi_master.h"
#include "freertos/FreeRTOS.h"
#include "freertos/task.h"

#include "axis.h"

#if RDPI_PARAMS_DAC_BITS != 16
#error "fit with --dac-bits 16"
#endif

#define RATE_HZ 1000

bool run_axis(spi_device_handle_t device);

static spi_device_handle_t dac;
static TaskHandle_t task;

static bool on_alarm(gptimer_handle_t timer, const gptimer_alarm_event_data_t *event, void *context)
{
    (void)timer;
    (void)event;
    (void)context;
    BaseType_t woken = pdFALSE;
    vTaskNotifyGiveFromISR(task, &woken);
    return woken == pdTRUE;
}

/* Its 24 bits: command 3, "write to and update the DAC register"; the code; four bits that do not matter. */
static void write_dac(uint32_t code)
{
    spi_transaction_t frame = {
        .flags = SPI_TRANS_USE_TXDATA,
        .length = 24,
        .tx_data = {(uint8_t)(0x30u | code >> 12), (uint8_t)(code >> 4), (uint8_t)(code << 4)},
    };
    (void)spi_device_polling_transmit(dac, &frame);
}

/* A notification is a counter: what it is more than 1 are ticks that the task was too late for. */
static void follow(void *context)
{
    (void)context;
    uint32_t code = axis_first_code();
    for (;;) {
        uint32_t ticks = ulTaskNotifyTake(pdTRUE, portMAX_DELAY);
        write_dac(code);
        code = axis_next(ticks - 1u);
    }
}

bool run_axis(spi_device_handle_t device)
{
    dac = device;
    if (axis_start(RATE_HZ) != RDPI_OK) {
        return false;
    }
    gptimer_handle_t timer = NULL;
    const gptimer_config_t clock = {
        .clk_src = GPTIMER_CLK_SRC_DEFAULT, .direction = GPTIMER_COUNT_UP, .resolution_hz = 1000000};
    const gptimer_alarm_config_t period = {.alarm_count = 1000000 / RATE_HZ, .flags = {.auto_reload_on_alarm = 1}};
    const gptimer_event_callbacks_t callbacks = {.on_alarm = on_alarm};
    return gptimer_new_timer(&clock, &timer) == ESP_OK && gptimer_set_alarm_action(timer, &period) == ESP_OK &&
           gptimer_register_event_callbacks(timer, &callbacks, NULL) == ESP_OK &&
           xTaskCreate(follow, "axis", 2048, NULL, configMAX_PRIORITIES - 1, &task) == pdPASS &&
           gptimer_enable(timer) == ESP_OK && gptimer_start(timer) == ESP_OK;
}
