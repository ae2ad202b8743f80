/PROG  POLISH
/ATTR
OWNER		= MNEDITOR;
COMMENT		= "polishd";
LINE_COUNT	= 370;
DEFAULT_GROUP	= 1,*,*,*,*;
/MN
   1:  !raster, the cell's aperture, pitch 0.97 mm, step 1.25 mm: 36 ;
   2:  UFRAME_NUM=1 ;
   3:  UTOOL_NUM=1 ;
   4:J P[1] 10% FINE    ;
   5:L P[2] 300mm/sec FINE    ;
   6:L P[3] 0.081sec CNT100    ;
   7:L P[4] 0.08sec CNT100    ;
   8:L P[5] 0.081sec CNT100    ;
   9:L P[6] 0.081sec CNT100    ;
  10:L P[7] 0.08sec CNT100    ;
  11:L P[8] 0.081sec CNT100    ;
  12:L P[9] 0.081sec CNT100    ;
  13:L P[10] 0.08sec CNT100    ;
  14:L P[11] 0.081sec CNT100    ;
  15:L P[12] 0.081sec CNT100    ;
  16:L P[13] 0.08sec CNT100    ;
  17:L P[14] 0.081sec CNT100    ;
  18:L P[15] 0.081sec CNT100    ;
  19:L P[16] 0.064sec CNT100    ;
  20:L P[17] 0.079sec CNT100    ;
  21:L P[18] 0.08sec CNT100    ;
  22:L P[19] 0.079sec CNT100    ;
  23:L P[20] 0.079sec CNT100    ;
  24:L P[21] 0.079sec CNT100    ;
  25:L P[22] 0.079sec CNT100    ;
  26:L P[23] 0.08sec CNT100    ;
  27:L P[24] 0.079sec CNT100    ;
  28:L P[25] 0.079sec CNT100    ;
  29:L P[26] 0.079sec CNT100    ;
  30:L P[27] 0.065sec CNT100    ;
  31:L P[28] 0.08sec CNT100    ;
  32:L P[29] 0.081sec CNT100    ;
  33:L P[30] 0.08sec CNT100    ;
  34:L P[31] 0.081sec CNT100    ;
  35:L P[32] 0.08sec CNT100    ;
  36:L P[33] 0.081sec CNT100    ;
  37:L P[34] 0.08sec CNT100    ;
  38:L P[35] 0.081sec CNT100    ;
  39:L P[36] 0.08sec CNT100    ;
  40:L P[37] 0.081sec CNT100    ;
  41:L P[38] 0.08sec CNT100    ;
  42:L P[39] 0.081sec CNT100    ;
  43:L P[40] 0.064sec CNT100    ;
  44:L P[41] 0.085sec CNT100    ;
  45:L P[42] 0.084sec CNT100    ;
  46:L P[43] 0.085sec CNT100    ;
  47:L P[44] 0.084sec CNT100    ;
  48:L P[45] 0.084sec CNT100    ;
  49:L P[46] 0.085sec CNT100    ;
  50:L P[47] 0.084sec CNT100    ;
  51:L P[48] 0.084sec CNT100    ;
  52:L P[49] 0.085sec CNT100    ;
  53:L P[50] 0.084sec CNT100    ;
  54:L P[51] 0.084sec CNT100    ;
  55:L P[52] 0.085sec CNT100    ;
  56:L P[53] 0.084sec CNT100    ;
  57:L P[54] 0.065sec CNT100    ;
  58:L P[55] 0.085sec CNT100    ;
  59:L P[56] 0.086sec CNT100    ;
  60:L P[57] 0.086sec CNT100    ;
  61:L P[58] 0.085sec CNT100    ;
  62:L P[59] 0.086sec CNT100    ;
  63:L P[60] 0.086sec CNT100    ;
  64:L P[61] 0.085sec CNT100    ;
  65:L P[62] 0.086sec CNT100    ;
  66:L P[63] 0.086sec CNT100    ;
  67:L P[64] 0.085sec CNT100    ;
  68:L P[65] 0.086sec CNT100    ;
  69:L P[66] 0.086sec CNT100    ;
  70:L P[67] 0.085sec CNT100    ;
  71:L P[68] 0.086sec CNT100    ;
  72:L P[69] 0.065sec CNT100    ;
  73:L P[70] 0.085sec CNT100    ;
  74:L P[71] 0.085sec CNT100    ;
  75:L P[72] 0.086sec CNT100    ;
  76:L P[73] 0.085sec CNT100    ;
  77:L P[74] 0.085sec CNT100    ;
  78:L P[75] 0.086sec CNT100    ;
  79:L P[76] 0.085sec CNT100    ;
  80:L P[77] 0.086sec CNT100    ;
  81:L P[78] 0.085sec CNT100    ;
  82:L P[79] 0.085sec CNT100    ;
  83:L P[80] 0.086sec CNT100    ;
  84:L P[81] 0.085sec CNT100    ;
  85:L P[82] 0.085sec CNT100    ;
  86:L P[83] 0.086sec CNT100    ;
  87:L P[84] 0.085sec CNT100    ;
  88:L P[85] 0.065sec CNT100    ;
  89:L P[86] 0.084sec CNT100    ;
  90:L P[87] 0.084sec CNT100    ;
  91:L P[88] 0.084sec CNT100    ;
  92:L P[89] 0.084sec CNT100    ;
  93:L P[90] 0.084sec CNT100    ;
  94:L P[91] 0.084sec CNT100    ;
  95:L P[92] 0.084sec CNT100    ;
  96:L P[93] 0.084sec CNT100    ;
  97:L P[94] 0.084sec CNT100    ;
  98:L P[95] 0.084sec CNT100    ;
  99:L P[96] 0.084sec CNT100    ;
 100:L P[97] 0.084sec CNT100    ;
 101:L P[98] 0.084sec CNT100    ;
 102:L P[99] 0.084sec CNT100    ;
 103:L P[100] 0.084sec CNT100    ;
 104:L P[101] 0.084sec CNT100    ;
 105:L P[102] 0.065sec CNT100    ;
 106:L P[103] 0.082sec CNT100    ;
 107:L P[104] 0.082sec CNT100    ;
 108:L P[105] 0.082sec CNT100    ;
 109:L P[106] 0.082sec CNT100    ;
 110:L P[107] 0.082sec CNT100    ;
 111:L P[108] 0.082sec CNT100    ;
 112:L P[109] 0.082sec CNT100    ;
 113:L P[110] 0.082sec CNT100    ;
 114:L P[111] 0.082sec CNT100    ;
 115:L P[112] 0.082sec CNT100    ;
 116:L P[113] 0.081sec CNT100    ;
 117:L P[114] 0.082sec CNT100    ;
 118:L P[115] 0.082sec CNT100    ;
 119:L P[116] 0.082sec CNT100    ;
 120:L P[117] 0.082sec CNT100    ;
 121:L P[118] 0.082sec CNT100    ;
 122:L P[119] 0.082sec CNT100    ;
 123:L P[120] 0.065sec CNT100    ;
 124:L P[121] 0.084sec CNT100    ;
 125:L P[122] 0.084sec CNT100    ;
 126:L P[123] 0.084sec CNT100    ;
 127:L P[124] 0.084sec CNT100    ;
 128:L P[125] 0.084sec CNT100    ;
 129:L P[126] 0.084sec CNT100    ;
 130:L P[127] 0.084sec CNT100    ;
 131:L P[128] 0.084sec CNT100    ;
 132:L P[129] 0.084sec CNT100    ;
 133:L P[130] 0.085sec CNT100    ;
 134:L P[131] 0.084sec CNT100    ;
 135:L P[132] 0.084sec CNT100    ;
 136:L P[133] 0.084sec CNT100    ;
 137:L P[134] 0.084sec CNT100    ;
 138:L P[135] 0.084sec CNT100    ;
 139:L P[136] 0.084sec CNT100    ;
 140:L P[137] 0.084sec CNT100    ;
 141:L P[138] 0.065sec CNT100    ;
 142:L P[139] 0.085sec CNT100    ;
 143:L P[140] 0.086sec CNT100    ;
 144:L P[141] 0.085sec CNT100    ;
 145:L P[142] 0.085sec CNT100    ;
 146:L P[143] 0.086sec CNT100    ;
 147:L P[144] 0.085sec CNT100    ;
 148:L P[145] 0.086sec CNT100    ;
 149:L P[146] 0.085sec CNT100    ;
 150:L P[147] 0.086sec CNT100    ;
 151:L P[148] 0.085sec CNT100    ;
 152:L P[149] 0.085sec CNT100    ;
 153:L P[150] 0.086sec CNT100    ;
 154:L P[151] 0.085sec CNT100    ;
 155:L P[152] 0.086sec CNT100    ;
 156:L P[153] 0.085sec CNT100    ;
 157:L P[154] 0.086sec CNT100    ;
 158:L P[155] 0.085sec CNT100    ;
 159:L P[156] 0.065sec CNT100    ;
 160:L P[157] 0.081sec CNT100    ;
 161:L P[158] 0.081sec CNT100    ;
 162:L P[159] 0.082sec CNT100    ;
 163:L P[160] 0.081sec CNT100    ;
 164:L P[161] 0.081sec CNT100    ;
 165:L P[162] 0.082sec CNT100    ;
 166:L P[163] 0.081sec CNT100    ;
 167:L P[164] 0.081sec CNT100    ;
 168:L P[165] 0.082sec CNT100    ;
 169:L P[166] 0.081sec CNT100    ;
 170:L P[167] 0.081sec CNT100    ;
 171:L P[168] 0.082sec CNT100    ;
 172:L P[169] 0.081sec CNT100    ;
 173:L P[170] 0.081sec CNT100    ;
 174:L P[171] 0.081sec CNT100    ;
 175:L P[172] 0.082sec CNT100    ;
 176:L P[173] 0.081sec CNT100    ;
 177:L P[174] 0.081sec CNT100    ;
 178:L P[175] 0.065sec CNT100    ;
 179:L P[176] 0.082sec CNT100    ;
 180:L P[177] 0.081sec CNT100    ;
 181:L P[178] 0.082sec CNT100    ;
 182:L P[179] 0.081sec CNT100    ;
 183:L P[180] 0.082sec CNT100    ;
 184:L P[181] 0.081sec CNT100    ;
 185:L P[182] 0.082sec CNT100    ;
 186:L P[183] 0.081sec CNT100    ;
 187:L P[184] 0.081sec CNT100    ;
 188:L P[185] 0.082sec CNT100    ;
 189:L P[186] 0.081sec CNT100    ;
 190:L P[187] 0.082sec CNT100    ;
 191:L P[188] 0.081sec CNT100    ;
 192:L P[189] 0.082sec CNT100    ;
 193:L P[190] 0.081sec CNT100    ;
 194:L P[191] 0.082sec CNT100    ;
 195:L P[192] 0.081sec CNT100    ;
 196:L P[193] 0.082sec CNT100    ;
 197:L P[194] 0.064sec CNT100    ;
 198:L P[195] 0.082sec CNT100    ;
 199:L P[196] 0.081sec CNT100    ;
 200:L P[197] 0.081sec CNT100    ;
 201:L P[198] 0.082sec CNT100    ;
 202:L P[199] 0.081sec CNT100    ;
 203:L P[200] 0.081sec CNT100    ;
 204:L P[201] 0.082sec CNT100    ;
 205:L P[202] 0.081sec CNT100    ;
 206:L P[203] 0.081sec CNT100    ;
 207:L P[204] 0.082sec CNT100    ;
 208:L P[205] 0.081sec CNT100    ;
 209:L P[206] 0.081sec CNT100    ;
 210:L P[207] 0.082sec CNT100    ;
 211:L P[208] 0.081sec CNT100    ;
 212:L P[209] 0.081sec CNT100    ;
 213:L P[210] 0.082sec CNT100    ;
 214:L P[211] 0.081sec CNT100    ;
 215:L P[212] 0.081sec CNT100    ;
 216:L P[213] 0.065sec CNT100    ;
 217:L P[214] 0.085sec CNT100    ;
 218:L P[215] 0.086sec CNT100    ;
 219:L P[216] 0.085sec CNT100    ;
 220:L P[217] 0.086sec CNT100    ;
 221:L P[218] 0.085sec CNT100    ;
 222:L P[219] 0.086sec CNT100    ;
 223:L P[220] 0.085sec CNT100    ;
 224:L P[221] 0.085sec CNT100    ;
 225:L P[222] 0.086sec CNT100    ;
 226:L P[223] 0.085sec CNT100    ;
 227:L P[224] 0.086sec CNT100    ;
 228:L P[225] 0.085sec CNT100    ;
 229:L P[226] 0.086sec CNT100    ;
 230:L P[227] 0.085sec CNT100    ;
 231:L P[228] 0.085sec CNT100    ;
 232:L P[229] 0.086sec CNT100    ;
 233:L P[230] 0.085sec CNT100    ;
 234:L P[231] 0.065sec CNT100    ;
 235:L P[232] 0.084sec CNT100    ;
 236:L P[233] 0.084sec CNT100    ;
 237:L P[234] 0.084sec CNT100    ;
 238:L P[235] 0.084sec CNT100    ;
 239:L P[236] 0.084sec CNT100    ;
 240:L P[237] 0.084sec CNT100    ;
 241:L P[238] 0.084sec CNT100    ;
 242:L P[239] 0.084sec CNT100    ;
 243:L P[240] 0.085sec CNT100    ;
 244:L P[241] 0.084sec CNT100    ;
 245:L P[242] 0.084sec CNT100    ;
 246:L P[243] 0.084sec CNT100    ;
 247:L P[244] 0.084sec CNT100    ;
 248:L P[245] 0.084sec CNT100    ;
 249:L P[246] 0.084sec CNT100    ;
 250:L P[247] 0.084sec CNT100    ;
 251:L P[248] 0.084sec CNT100    ;
 252:L P[249] 0.065sec CNT100    ;
 253:L P[250] 0.082sec CNT100    ;
 254:L P[251] 0.082sec CNT100    ;
 255:L P[252] 0.082sec CNT100    ;
 256:L P[253] 0.082sec CNT100    ;
 257:L P[254] 0.081sec CNT100    ;
 258:L P[255] 0.082sec CNT100    ;
 259:L P[256] 0.082sec CNT100    ;
 260:L P[257] 0.082sec CNT100    ;
 261:L P[258] 0.082sec CNT100    ;
 262:L P[259] 0.082sec CNT100    ;
 263:L P[260] 0.082sec CNT100    ;
 264:L P[261] 0.082sec CNT100    ;
 265:L P[262] 0.082sec CNT100    ;
 266:L P[263] 0.082sec CNT100    ;
 267:L P[264] 0.082sec CNT100    ;
 268:L P[265] 0.082sec CNT100    ;
 269:L P[266] 0.082sec CNT100    ;
 270:L P[267] 0.065sec CNT100    ;
 271:L P[268] 0.084sec CNT100    ;
 272:L P[269] 0.084sec CNT100    ;
 273:L P[270] 0.084sec CNT100    ;
 274:L P[271] 0.084sec CNT100    ;
 275:L P[272] 0.084sec CNT100    ;
 276:L P[273] 0.084sec CNT100    ;
 277:L P[274] 0.084sec CNT100    ;
 278:L P[275] 0.084sec CNT100    ;
 279:L P[276] 0.084sec CNT100    ;
 280:L P[277] 0.084sec CNT100    ;
 281:L P[278] 0.084sec CNT100    ;
 282:L P[279] 0.084sec CNT100    ;
 283:L P[280] 0.084sec CNT100    ;
 284:L P[281] 0.084sec CNT100    ;
 285:L P[282] 0.084sec CNT100    ;
 286:L P[283] 0.084sec CNT100    ;
 287:L P[284] 0.065sec CNT100    ;
 288:L P[285] 0.085sec CNT100    ;
 289:L P[286] 0.086sec CNT100    ;
 290:L P[287] 0.085sec CNT100    ;
 291:L P[288] 0.085sec CNT100    ;
 292:L P[289] 0.086sec CNT100    ;
 293:L P[290] 0.085sec CNT100    ;
 294:L P[291] 0.085sec CNT100    ;
 295:L P[292] 0.086sec CNT100    ;
 296:L P[293] 0.085sec CNT100    ;
 297:L P[294] 0.085sec CNT100    ;
 298:L P[295] 0.086sec CNT100    ;
 299:L P[296] 0.085sec CNT100    ;
 300:L P[297] 0.086sec CNT100    ;
 301:L P[298] 0.085sec CNT100    ;
 302:L P[299] 0.085sec CNT100    ;
 303:L P[300] 0.065sec CNT100    ;
 304:L P[301] 0.086sec CNT100    ;
 305:L P[302] 0.085sec CNT100    ;
 306:L P[303] 0.086sec CNT100    ;
 307:L P[304] 0.086sec CNT100    ;
 308:L P[305] 0.085sec CNT100    ;
 309:L P[306] 0.086sec CNT100    ;
 310:L P[307] 0.086sec CNT100    ;
 311:L P[308] 0.085sec CNT100    ;
 312:L P[309] 0.086sec CNT100    ;
 313:L P[310] 0.086sec CNT100    ;
 314:L P[311] 0.085sec CNT100    ;
 315:L P[312] 0.086sec CNT100    ;
 316:L P[313] 0.085sec CNT100    ;
 317:L P[314] 0.086sec CNT100    ;
 318:L P[315] 0.065sec CNT100    ;
 319:L P[316] 0.084sec CNT100    ;
 320:L P[317] 0.085sec CNT100    ;
 321:L P[318] 0.084sec CNT100    ;
 322:L P[319] 0.084sec CNT100    ;
 323:L P[320] 0.085sec CNT100    ;
 324:L P[321] 0.084sec CNT100    ;
 325:L P[322] 0.084sec CNT100    ;
 326:L P[323] 0.085sec CNT100    ;
 327:L P[324] 0.084sec CNT100    ;
 328:L P[325] 0.084sec CNT100    ;
 329:L P[326] 0.085sec CNT100    ;
 330:L P[327] 0.084sec CNT100    ;
 331:L P[328] 0.084sec CNT100    ;
 332:L P[329] 0.065sec CNT100    ;
 333:L P[330] 0.081sec CNT100    ;
 334:L P[331] 0.08sec CNT100    ;
 335:L P[332] 0.081sec CNT100    ;
 336:L P[333] 0.08sec CNT100    ;
 337:L P[334] 0.081sec CNT100    ;
 338:L P[335] 0.08sec CNT100    ;
 339:L P[336] 0.081sec CNT100    ;
 340:L P[337] 0.08sec CNT100    ;
 341:L P[338] 0.081sec CNT100    ;
 342:L P[339] 0.08sec CNT100    ;
 343:L P[340] 0.081sec CNT100    ;
 344:L P[341] 0.08sec CNT100    ;
 345:L P[342] 0.065sec CNT100    ;
 346:L P[343] 0.079sec CNT100    ;
 347:L P[344] 0.079sec CNT100    ;
 348:L P[345] 0.079sec CNT100    ;
 349:L P[346] 0.079sec CNT100    ;
 350:L P[347] 0.08sec CNT100    ;
 351:L P[348] 0.079sec CNT100    ;
 352:L P[349] 0.079sec CNT100    ;
 353:L P[350] 0.079sec CNT100    ;
 354:L P[351] 0.079sec CNT100    ;
 355:L P[352] 0.08sec CNT100    ;
 356:L P[353] 0.064sec CNT100    ;
 357:L P[354] 0.081sec CNT100    ;
 358:L P[355] 0.081sec CNT100    ;
 359:L P[356] 0.08sec CNT100    ;
 360:L P[357] 0.081sec CNT100    ;
 361:L P[358] 0.081sec CNT100    ;
 362:L P[359] 0.08sec CNT100    ;
 363:L P[360] 0.081sec CNT100    ;
 364:L P[361] 0.081sec CNT100    ;
 365:L P[362] 0.08sec CNT100    ;
 366:L P[363] 0.081sec CNT100    ;
 367:L P[364] 0.081sec CNT100    ;
 368:L P[365] 0.08sec CNT100    ;
 369:L P[366] 0.081sec CNT100    ;
 370:L P[367] 300mm/sec FINE    ;
/POS
P[1]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -10.543  mm,	Y = 10.670  mm,	Z = 20.000  mm,
	W = -179.834 deg,	P = -14.999 deg,	R = -0.022 deg
};
P[2]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -10.543  mm,	Y = 10.670  mm,	Z = 0.000  mm,
	W = -179.834 deg,	P = -14.999 deg,	R = -0.022 deg
};
P[3]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -9.333  mm,	Y = 10.670  mm,	Z = 0.000  mm,
	W = -179.835 deg,	P = -14.999 deg,	R = -0.022 deg
};
P[4]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -8.123  mm,	Y = 10.670  mm,	Z = 0.000  mm,
	W = -179.835 deg,	P = -14.999 deg,	R = -0.022 deg
};
P[5]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -6.913  mm,	Y = 10.670  mm,	Z = 0.000  mm,
	W = -179.835 deg,	P = -14.999 deg,	R = -0.022 deg
};
P[6]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -5.703  mm,	Y = 10.670  mm,	Z = 0.000  mm,
	W = -179.835 deg,	P = -14.999 deg,	R = -0.022 deg
};
P[7]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -4.493  mm,	Y = 10.670  mm,	Z = 0.000  mm,
	W = -179.835 deg,	P = -14.999 deg,	R = -0.022 deg
};
P[8]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -3.283  mm,	Y = 10.670  mm,	Z = 0.000  mm,
	W = -179.836 deg,	P = -14.999 deg,	R = -0.022 deg
};
P[9]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -2.073  mm,	Y = 10.670  mm,	Z = 0.000  mm,
	W = -179.836 deg,	P = -14.999 deg,	R = -0.022 deg
};
P[10]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -0.863  mm,	Y = 10.670  mm,	Z = 0.000  mm,
	W = -179.836 deg,	P = -14.999 deg,	R = -0.022 deg
};
P[11]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 0.347  mm,	Y = 10.670  mm,	Z = 0.000  mm,
	W = -179.836 deg,	P = -14.999 deg,	R = -0.022 deg
};
P[12]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 1.557  mm,	Y = 10.670  mm,	Z = 0.000  mm,
	W = -179.836 deg,	P = -14.999 deg,	R = -0.022 deg
};
P[13]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 2.767  mm,	Y = 10.670  mm,	Z = 0.000  mm,
	W = -179.837 deg,	P = -14.999 deg,	R = -0.022 deg
};
P[14]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 3.977  mm,	Y = 10.670  mm,	Z = 0.000  mm,
	W = -179.837 deg,	P = -14.999 deg,	R = -0.021 deg
};
P[15]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 5.187  mm,	Y = 10.670  mm,	Z = 0.000  mm,
	W = -179.837 deg,	P = -14.999 deg,	R = -0.021 deg
};
P[16]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 5.187  mm,	Y = 9.700  mm,	Z = 0.000  mm,
	W = -179.852 deg,	P = -14.999 deg,	R = -0.020 deg
};
P[17]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 4.000  mm,	Y = 9.700  mm,	Z = 0.000  mm,
	W = -179.852 deg,	P = -14.999 deg,	R = -0.020 deg
};
P[18]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 2.812  mm,	Y = 9.700  mm,	Z = 0.000  mm,
	W = -179.852 deg,	P = -14.999 deg,	R = -0.020 deg
};
P[19]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 1.624  mm,	Y = 9.700  mm,	Z = 0.000  mm,
	W = -179.851 deg,	P = -14.999 deg,	R = -0.020 deg
};
P[20]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 0.436  mm,	Y = 9.700  mm,	Z = 0.000  mm,
	W = -179.851 deg,	P = -14.999 deg,	R = -0.020 deg
};
P[21]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -0.752  mm,	Y = 9.700  mm,	Z = 0.000  mm,
	W = -179.851 deg,	P = -14.999 deg,	R = -0.020 deg
};
P[22]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -1.940  mm,	Y = 9.700  mm,	Z = 0.000  mm,
	W = -179.851 deg,	P = -14.999 deg,	R = -0.020 deg
};
P[23]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -3.128  mm,	Y = 9.700  mm,	Z = 0.000  mm,
	W = -179.851 deg,	P = -14.999 deg,	R = -0.020 deg
};
P[24]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -4.316  mm,	Y = 9.700  mm,	Z = 0.000  mm,
	W = -179.850 deg,	P = -14.999 deg,	R = -0.020 deg
};
P[25]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -5.504  mm,	Y = 9.700  mm,	Z = 0.000  mm,
	W = -179.850 deg,	P = -14.999 deg,	R = -0.020 deg
};
P[26]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -6.692  mm,	Y = 9.700  mm,	Z = 0.000  mm,
	W = -179.850 deg,	P = -14.999 deg,	R = -0.020 deg
};
P[27]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -6.692  mm,	Y = 8.730  mm,	Z = 0.000  mm,
	W = -179.865 deg,	P = -14.999 deg,	R = -0.018 deg
};
P[28]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -5.485  mm,	Y = 8.730  mm,	Z = 0.000  mm,
	W = -179.865 deg,	P = -14.999 deg,	R = -0.018 deg
};
P[29]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -4.278  mm,	Y = 8.730  mm,	Z = 0.000  mm,
	W = -179.865 deg,	P = -14.999 deg,	R = -0.018 deg
};
P[30]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -3.070  mm,	Y = 8.730  mm,	Z = 0.000  mm,
	W = -179.866 deg,	P = -14.999 deg,	R = -0.018 deg
};
P[31]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -1.863  mm,	Y = 8.730  mm,	Z = 0.000  mm,
	W = -179.866 deg,	P = -14.999 deg,	R = -0.018 deg
};
P[32]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -0.655  mm,	Y = 8.730  mm,	Z = 0.000  mm,
	W = -179.866 deg,	P = -14.999 deg,	R = -0.018 deg
};
P[33]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 0.552  mm,	Y = 8.730  mm,	Z = 0.000  mm,
	W = -179.866 deg,	P = -14.999 deg,	R = -0.018 deg
};
P[34]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 1.759  mm,	Y = 8.730  mm,	Z = 0.000  mm,
	W = -179.866 deg,	P = -14.999 deg,	R = -0.018 deg
};
P[35]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 2.967  mm,	Y = 8.730  mm,	Z = 0.000  mm,
	W = -179.866 deg,	P = -14.999 deg,	R = -0.018 deg
};
P[36]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 4.174  mm,	Y = 8.730  mm,	Z = 0.000  mm,
	W = -179.867 deg,	P = -14.999 deg,	R = -0.018 deg
};
P[37]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 5.382  mm,	Y = 8.730  mm,	Z = 0.000  mm,
	W = -179.867 deg,	P = -14.999 deg,	R = -0.018 deg
};
P[38]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 6.589  mm,	Y = 8.730  mm,	Z = 0.000  mm,
	W = -179.867 deg,	P = -14.999 deg,	R = -0.018 deg
};
P[39]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 7.796  mm,	Y = 8.730  mm,	Z = 0.000  mm,
	W = -179.867 deg,	P = -14.999 deg,	R = -0.018 deg
};
P[40]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 7.796  mm,	Y = 7.760  mm,	Z = 0.000  mm,
	W = -179.882 deg,	P = -15.000 deg,	R = -0.016 deg
};
P[41]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 6.531  mm,	Y = 7.760  mm,	Z = 0.000  mm,
	W = -179.882 deg,	P = -15.000 deg,	R = -0.016 deg
};
P[42]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 5.265  mm,	Y = 7.760  mm,	Z = 0.000  mm,
	W = -179.881 deg,	P = -15.000 deg,	R = -0.016 deg
};
P[43]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 4.000  mm,	Y = 7.760  mm,	Z = 0.000  mm,
	W = -179.881 deg,	P = -15.000 deg,	R = -0.016 deg
};
P[44]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 2.735  mm,	Y = 7.760  mm,	Z = 0.000  mm,
	W = -179.881 deg,	P = -15.000 deg,	R = -0.016 deg
};
P[45]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 1.469  mm,	Y = 7.760  mm,	Z = 0.000  mm,
	W = -179.881 deg,	P = -15.000 deg,	R = -0.016 deg
};
P[46]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 0.204  mm,	Y = 7.760  mm,	Z = 0.000  mm,
	W = -179.881 deg,	P = -15.000 deg,	R = -0.016 deg
};
P[47]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -1.062  mm,	Y = 7.760  mm,	Z = 0.000  mm,
	W = -179.881 deg,	P = -15.000 deg,	R = -0.016 deg
};
P[48]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -2.327  mm,	Y = 7.760  mm,	Z = 0.000  mm,
	W = -179.881 deg,	P = -15.000 deg,	R = -0.016 deg
};
P[49]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -3.593  mm,	Y = 7.760  mm,	Z = 0.000  mm,
	W = -179.880 deg,	P = -15.000 deg,	R = -0.016 deg
};
P[50]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -4.858  mm,	Y = 7.760  mm,	Z = 0.000  mm,
	W = -179.880 deg,	P = -15.000 deg,	R = -0.016 deg
};
P[51]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -6.123  mm,	Y = 7.760  mm,	Z = 0.000  mm,
	W = -179.880 deg,	P = -15.000 deg,	R = -0.016 deg
};
P[52]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -7.389  mm,	Y = 7.760  mm,	Z = 0.000  mm,
	W = -179.880 deg,	P = -15.000 deg,	R = -0.016 deg
};
P[53]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -8.654  mm,	Y = 7.760  mm,	Z = 0.000  mm,
	W = -179.880 deg,	P = -15.000 deg,	R = -0.016 deg
};
P[54]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -8.654  mm,	Y = 6.790  mm,	Z = 0.000  mm,
	W = -179.895 deg,	P = -15.000 deg,	R = -0.014 deg
};
P[55]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -7.369  mm,	Y = 6.790  mm,	Z = 0.000  mm,
	W = -179.895 deg,	P = -15.000 deg,	R = -0.014 deg
};
P[56]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -6.084  mm,	Y = 6.790  mm,	Z = 0.000  mm,
	W = -179.895 deg,	P = -15.000 deg,	R = -0.014 deg
};
P[57]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -4.800  mm,	Y = 6.790  mm,	Z = 0.000  mm,
	W = -179.895 deg,	P = -15.000 deg,	R = -0.014 deg
};
P[58]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -3.515  mm,	Y = 6.790  mm,	Z = 0.000  mm,
	W = -179.895 deg,	P = -15.000 deg,	R = -0.014 deg
};
P[59]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -2.230  mm,	Y = 6.790  mm,	Z = 0.000  mm,
	W = -179.896 deg,	P = -15.000 deg,	R = -0.014 deg
};
P[60]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -0.945  mm,	Y = 6.790  mm,	Z = 0.000  mm,
	W = -179.896 deg,	P = -15.000 deg,	R = -0.014 deg
};
P[61]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 0.340  mm,	Y = 6.790  mm,	Z = 0.000  mm,
	W = -179.896 deg,	P = -15.000 deg,	R = -0.014 deg
};
P[62]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 1.625  mm,	Y = 6.790  mm,	Z = 0.000  mm,
	W = -179.896 deg,	P = -15.000 deg,	R = -0.014 deg
};
P[63]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 2.910  mm,	Y = 6.790  mm,	Z = 0.000  mm,
	W = -179.896 deg,	P = -15.000 deg,	R = -0.014 deg
};
P[64]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 4.195  mm,	Y = 6.790  mm,	Z = 0.000  mm,
	W = -179.896 deg,	P = -15.000 deg,	R = -0.014 deg
};
P[65]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 5.480  mm,	Y = 6.790  mm,	Z = 0.000  mm,
	W = -179.896 deg,	P = -15.000 deg,	R = -0.014 deg
};
P[66]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 6.764  mm,	Y = 6.790  mm,	Z = 0.000  mm,
	W = -179.896 deg,	P = -15.000 deg,	R = -0.014 deg
};
P[67]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 8.049  mm,	Y = 6.790  mm,	Z = 0.000  mm,
	W = -179.897 deg,	P = -15.000 deg,	R = -0.014 deg
};
P[68]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 9.334  mm,	Y = 6.790  mm,	Z = 0.000  mm,
	W = -179.897 deg,	P = -15.000 deg,	R = -0.014 deg
};
P[69]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 9.334  mm,	Y = 5.820  mm,	Z = 0.000  mm,
	W = -179.911 deg,	P = -15.000 deg,	R = -0.012 deg
};
P[70]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 8.054  mm,	Y = 5.820  mm,	Z = 0.000  mm,
	W = -179.911 deg,	P = -15.000 deg,	R = -0.012 deg
};
P[71]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 6.773  mm,	Y = 5.820  mm,	Z = 0.000  mm,
	W = -179.911 deg,	P = -15.000 deg,	R = -0.012 deg
};
P[72]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 5.493  mm,	Y = 5.820  mm,	Z = 0.000  mm,
	W = -179.911 deg,	P = -15.000 deg,	R = -0.012 deg
};
P[73]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 4.212  mm,	Y = 5.820  mm,	Z = 0.000  mm,
	W = -179.911 deg,	P = -15.000 deg,	R = -0.012 deg
};
P[74]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 2.932  mm,	Y = 5.820  mm,	Z = 0.000  mm,
	W = -179.911 deg,	P = -15.000 deg,	R = -0.012 deg
};
P[75]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 1.651  mm,	Y = 5.820  mm,	Z = 0.000  mm,
	W = -179.911 deg,	P = -15.000 deg,	R = -0.012 deg
};
P[76]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 0.371  mm,	Y = 5.820  mm,	Z = 0.000  mm,
	W = -179.911 deg,	P = -15.000 deg,	R = -0.012 deg
};
P[77]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -0.910  mm,	Y = 5.820  mm,	Z = 0.000  mm,
	W = -179.911 deg,	P = -15.000 deg,	R = -0.012 deg
};
P[78]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -2.190  mm,	Y = 5.820  mm,	Z = 0.000  mm,
	W = -179.910 deg,	P = -15.000 deg,	R = -0.012 deg
};
P[79]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -3.471  mm,	Y = 5.820  mm,	Z = 0.000  mm,
	W = -179.910 deg,	P = -15.000 deg,	R = -0.012 deg
};
P[80]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -4.751  mm,	Y = 5.820  mm,	Z = 0.000  mm,
	W = -179.910 deg,	P = -15.000 deg,	R = -0.012 deg
};
P[81]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -6.032  mm,	Y = 5.820  mm,	Z = 0.000  mm,
	W = -179.910 deg,	P = -15.000 deg,	R = -0.012 deg
};
P[82]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -7.312  mm,	Y = 5.820  mm,	Z = 0.000  mm,
	W = -179.910 deg,	P = -15.000 deg,	R = -0.012 deg
};
P[83]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -8.593  mm,	Y = 5.820  mm,	Z = 0.000  mm,
	W = -179.910 deg,	P = -15.000 deg,	R = -0.012 deg
};
P[84]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -9.873  mm,	Y = 5.820  mm,	Z = 0.000  mm,
	W = -179.910 deg,	P = -15.000 deg,	R = -0.012 deg
};
P[85]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -9.873  mm,	Y = 4.850  mm,	Z = 0.000  mm,
	W = -179.925 deg,	P = -15.000 deg,	R = -0.010 deg
};
P[86]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -8.613  mm,	Y = 4.850  mm,	Z = 0.000  mm,
	W = -179.925 deg,	P = -15.000 deg,	R = -0.010 deg
};
P[87]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -7.352  mm,	Y = 4.850  mm,	Z = 0.000  mm,
	W = -179.925 deg,	P = -15.000 deg,	R = -0.010 deg
};
P[88]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -6.092  mm,	Y = 4.850  mm,	Z = 0.000  mm,
	W = -179.925 deg,	P = -15.000 deg,	R = -0.010 deg
};
P[89]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -4.832  mm,	Y = 4.850  mm,	Z = 0.000  mm,
	W = -179.925 deg,	P = -15.000 deg,	R = -0.010 deg
};
P[90]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -3.571  mm,	Y = 4.850  mm,	Z = 0.000  mm,
	W = -179.925 deg,	P = -15.000 deg,	R = -0.010 deg
};
P[91]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -2.311  mm,	Y = 4.850  mm,	Z = 0.000  mm,
	W = -179.925 deg,	P = -15.000 deg,	R = -0.010 deg
};
P[92]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -1.050  mm,	Y = 4.850  mm,	Z = 0.000  mm,
	W = -179.925 deg,	P = -15.000 deg,	R = -0.010 deg
};
P[93]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 0.210  mm,	Y = 4.850  mm,	Z = 0.000  mm,
	W = -179.926 deg,	P = -15.000 deg,	R = -0.010 deg
};
P[94]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 1.470  mm,	Y = 4.850  mm,	Z = 0.000  mm,
	W = -179.926 deg,	P = -15.000 deg,	R = -0.010 deg
};
P[95]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 2.731  mm,	Y = 4.850  mm,	Z = 0.000  mm,
	W = -179.926 deg,	P = -15.000 deg,	R = -0.010 deg
};
P[96]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 3.991  mm,	Y = 4.850  mm,	Z = 0.000  mm,
	W = -179.926 deg,	P = -15.000 deg,	R = -0.010 deg
};
P[97]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 5.251  mm,	Y = 4.850  mm,	Z = 0.000  mm,
	W = -179.926 deg,	P = -15.000 deg,	R = -0.010 deg
};
P[98]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 6.512  mm,	Y = 4.850  mm,	Z = 0.000  mm,
	W = -179.926 deg,	P = -15.000 deg,	R = -0.010 deg
};
P[99]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 7.772  mm,	Y = 4.850  mm,	Z = 0.000  mm,
	W = -179.926 deg,	P = -15.000 deg,	R = -0.010 deg
};
P[100]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 9.033  mm,	Y = 4.850  mm,	Z = 0.000  mm,
	W = -179.926 deg,	P = -15.000 deg,	R = -0.010 deg
};
P[101]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 10.293  mm,	Y = 4.850  mm,	Z = 0.000  mm,
	W = -179.926 deg,	P = -15.000 deg,	R = -0.010 deg
};
P[102]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 10.293  mm,	Y = 3.880  mm,	Z = 0.000  mm,
	W = -179.941 deg,	P = -15.000 deg,	R = -0.008 deg
};
P[103]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 9.064  mm,	Y = 3.880  mm,	Z = 0.000  mm,
	W = -179.941 deg,	P = -15.000 deg,	R = -0.008 deg
};
P[104]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 7.834  mm,	Y = 3.880  mm,	Z = 0.000  mm,
	W = -179.941 deg,	P = -15.000 deg,	R = -0.008 deg
};
P[105]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 6.605  mm,	Y = 3.880  mm,	Z = 0.000  mm,
	W = -179.941 deg,	P = -15.000 deg,	R = -0.008 deg
};
P[106]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 5.375  mm,	Y = 3.880  mm,	Z = 0.000  mm,
	W = -179.941 deg,	P = -15.000 deg,	R = -0.008 deg
};
P[107]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 4.146  mm,	Y = 3.880  mm,	Z = 0.000  mm,
	W = -179.941 deg,	P = -15.000 deg,	R = -0.008 deg
};
P[108]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 2.916  mm,	Y = 3.880  mm,	Z = 0.000  mm,
	W = -179.941 deg,	P = -15.000 deg,	R = -0.008 deg
};
P[109]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 1.687  mm,	Y = 3.880  mm,	Z = 0.000  mm,
	W = -179.941 deg,	P = -15.000 deg,	R = -0.008 deg
};
P[110]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 0.457  mm,	Y = 3.880  mm,	Z = 0.000  mm,
	W = -179.940 deg,	P = -15.000 deg,	R = -0.008 deg
};
P[111]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -0.772  mm,	Y = 3.880  mm,	Z = 0.000  mm,
	W = -179.940 deg,	P = -15.000 deg,	R = -0.008 deg
};
P[112]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -2.002  mm,	Y = 3.880  mm,	Z = 0.000  mm,
	W = -179.940 deg,	P = -15.000 deg,	R = -0.008 deg
};
P[113]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -3.231  mm,	Y = 3.880  mm,	Z = 0.000  mm,
	W = -179.940 deg,	P = -15.000 deg,	R = -0.008 deg
};
P[114]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -4.461  mm,	Y = 3.880  mm,	Z = 0.000  mm,
	W = -179.940 deg,	P = -15.000 deg,	R = -0.008 deg
};
P[115]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -5.690  mm,	Y = 3.880  mm,	Z = 0.000  mm,
	W = -179.940 deg,	P = -15.000 deg,	R = -0.008 deg
};
P[116]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -6.920  mm,	Y = 3.880  mm,	Z = 0.000  mm,
	W = -179.940 deg,	P = -15.000 deg,	R = -0.008 deg
};
P[117]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -8.149  mm,	Y = 3.880  mm,	Z = 0.000  mm,
	W = -179.940 deg,	P = -15.000 deg,	R = -0.008 deg
};
P[118]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -9.379  mm,	Y = 3.880  mm,	Z = 0.000  mm,
	W = -179.940 deg,	P = -15.000 deg,	R = -0.008 deg
};
P[119]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -10.608  mm,	Y = 3.880  mm,	Z = 0.000  mm,
	W = -179.940 deg,	P = -15.000 deg,	R = -0.008 deg
};
P[120]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -10.608  mm,	Y = 2.910  mm,	Z = 0.000  mm,
	W = -179.955 deg,	P = -15.000 deg,	R = -0.006 deg
};
P[121]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -9.347  mm,	Y = 2.910  mm,	Z = 0.000  mm,
	W = -179.955 deg,	P = -15.000 deg,	R = -0.006 deg
};
P[122]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -8.086  mm,	Y = 2.910  mm,	Z = 0.000  mm,
	W = -179.955 deg,	P = -15.000 deg,	R = -0.006 deg
};
P[123]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -6.825  mm,	Y = 2.910  mm,	Z = 0.000  mm,
	W = -179.955 deg,	P = -15.000 deg,	R = -0.006 deg
};
P[124]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -5.564  mm,	Y = 2.910  mm,	Z = 0.000  mm,
	W = -179.955 deg,	P = -15.000 deg,	R = -0.006 deg
};
P[125]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -4.303  mm,	Y = 2.910  mm,	Z = 0.000  mm,
	W = -179.955 deg,	P = -15.000 deg,	R = -0.006 deg
};
P[126]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -3.043  mm,	Y = 2.910  mm,	Z = 0.000  mm,
	W = -179.955 deg,	P = -15.000 deg,	R = -0.006 deg
};
P[127]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -1.782  mm,	Y = 2.910  mm,	Z = 0.000  mm,
	W = -179.955 deg,	P = -15.000 deg,	R = -0.006 deg
};
P[128]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -0.521  mm,	Y = 2.910  mm,	Z = 0.000  mm,
	W = -179.955 deg,	P = -15.000 deg,	R = -0.006 deg
};
P[129]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 0.740  mm,	Y = 2.910  mm,	Z = 0.000  mm,
	W = -179.955 deg,	P = -15.000 deg,	R = -0.006 deg
};
P[130]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 2.001  mm,	Y = 2.910  mm,	Z = 0.000  mm,
	W = -179.955 deg,	P = -15.000 deg,	R = -0.006 deg
};
P[131]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 3.262  mm,	Y = 2.910  mm,	Z = 0.000  mm,
	W = -179.955 deg,	P = -15.000 deg,	R = -0.006 deg
};
P[132]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 4.523  mm,	Y = 2.910  mm,	Z = 0.000  mm,
	W = -179.956 deg,	P = -15.000 deg,	R = -0.006 deg
};
P[133]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 5.784  mm,	Y = 2.910  mm,	Z = 0.000  mm,
	W = -179.956 deg,	P = -15.000 deg,	R = -0.006 deg
};
P[134]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 7.045  mm,	Y = 2.910  mm,	Z = 0.000  mm,
	W = -179.956 deg,	P = -15.000 deg,	R = -0.006 deg
};
P[135]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 8.306  mm,	Y = 2.910  mm,	Z = 0.000  mm,
	W = -179.956 deg,	P = -15.000 deg,	R = -0.006 deg
};
P[136]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 9.567  mm,	Y = 2.910  mm,	Z = 0.000  mm,
	W = -179.956 deg,	P = -15.000 deg,	R = -0.006 deg
};
P[137]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 10.828  mm,	Y = 2.910  mm,	Z = 0.000  mm,
	W = -179.956 deg,	P = -15.000 deg,	R = -0.006 deg
};
P[138]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 10.828  mm,	Y = 1.940  mm,	Z = 0.000  mm,
	W = -179.971 deg,	P = -15.000 deg,	R = -0.004 deg
};
P[139]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 9.546  mm,	Y = 1.940  mm,	Z = 0.000  mm,
	W = -179.970 deg,	P = -15.000 deg,	R = -0.004 deg
};
P[140]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 8.265  mm,	Y = 1.940  mm,	Z = 0.000  mm,
	W = -179.970 deg,	P = -15.000 deg,	R = -0.004 deg
};
P[141]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 6.983  mm,	Y = 1.940  mm,	Z = 0.000  mm,
	W = -179.970 deg,	P = -15.000 deg,	R = -0.004 deg
};
P[142]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 5.702  mm,	Y = 1.940  mm,	Z = 0.000  mm,
	W = -179.970 deg,	P = -15.000 deg,	R = -0.004 deg
};
P[143]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 4.420  mm,	Y = 1.940  mm,	Z = 0.000  mm,
	W = -179.970 deg,	P = -15.000 deg,	R = -0.004 deg
};
P[144]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 3.139  mm,	Y = 1.940  mm,	Z = 0.000  mm,
	W = -179.970 deg,	P = -15.000 deg,	R = -0.004 deg
};
P[145]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 1.857  mm,	Y = 1.940  mm,	Z = 0.000  mm,
	W = -179.970 deg,	P = -15.000 deg,	R = -0.004 deg
};
P[146]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 0.576  mm,	Y = 1.940  mm,	Z = 0.000  mm,
	W = -179.970 deg,	P = -15.000 deg,	R = -0.004 deg
};
P[147]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -0.706  mm,	Y = 1.940  mm,	Z = 0.000  mm,
	W = -179.970 deg,	P = -15.000 deg,	R = -0.004 deg
};
P[148]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -1.987  mm,	Y = 1.940  mm,	Z = 0.000  mm,
	W = -179.970 deg,	P = -15.000 deg,	R = -0.004 deg
};
P[149]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -3.268  mm,	Y = 1.940  mm,	Z = 0.000  mm,
	W = -179.970 deg,	P = -15.000 deg,	R = -0.004 deg
};
P[150]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -4.550  mm,	Y = 1.940  mm,	Z = 0.000  mm,
	W = -179.970 deg,	P = -15.000 deg,	R = -0.004 deg
};
P[151]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -5.831  mm,	Y = 1.940  mm,	Z = 0.000  mm,
	W = -179.970 deg,	P = -15.000 deg,	R = -0.004 deg
};
P[152]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -7.113  mm,	Y = 1.940  mm,	Z = 0.000  mm,
	W = -179.970 deg,	P = -15.000 deg,	R = -0.004 deg
};
P[153]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -8.394  mm,	Y = 1.940  mm,	Z = 0.000  mm,
	W = -179.970 deg,	P = -15.000 deg,	R = -0.004 deg
};
P[154]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -9.676  mm,	Y = 1.940  mm,	Z = 0.000  mm,
	W = -179.970 deg,	P = -15.000 deg,	R = -0.004 deg
};
P[155]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -10.957  mm,	Y = 1.940  mm,	Z = 0.000  mm,
	W = -179.970 deg,	P = -15.000 deg,	R = -0.004 deg
};
P[156]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -10.957  mm,	Y = 0.970  mm,	Z = 0.000  mm,
	W = -179.985 deg,	P = -15.000 deg,	R = -0.002 deg
};
P[157]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -9.737  mm,	Y = 0.970  mm,	Z = 0.000  mm,
	W = -179.985 deg,	P = -15.000 deg,	R = -0.002 deg
};
P[158]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -8.517  mm,	Y = 0.970  mm,	Z = 0.000  mm,
	W = -179.985 deg,	P = -15.000 deg,	R = -0.002 deg
};
P[159]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -7.298  mm,	Y = 0.970  mm,	Z = 0.000  mm,
	W = -179.985 deg,	P = -15.000 deg,	R = -0.002 deg
};
P[160]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -6.078  mm,	Y = 0.970  mm,	Z = 0.000  mm,
	W = -179.985 deg,	P = -15.000 deg,	R = -0.002 deg
};
P[161]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -4.858  mm,	Y = 0.970  mm,	Z = 0.000  mm,
	W = -179.985 deg,	P = -15.000 deg,	R = -0.002 deg
};
P[162]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -3.638  mm,	Y = 0.970  mm,	Z = 0.000  mm,
	W = -179.985 deg,	P = -15.000 deg,	R = -0.002 deg
};
P[163]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -2.418  mm,	Y = 0.970  mm,	Z = 0.000  mm,
	W = -179.985 deg,	P = -15.000 deg,	R = -0.002 deg
};
P[164]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -1.198  mm,	Y = 0.970  mm,	Z = 0.000  mm,
	W = -179.985 deg,	P = -15.000 deg,	R = -0.002 deg
};
P[165]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 0.021  mm,	Y = 0.970  mm,	Z = 0.000  mm,
	W = -179.985 deg,	P = -15.000 deg,	R = -0.002 deg
};
P[166]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 1.241  mm,	Y = 0.970  mm,	Z = 0.000  mm,
	W = -179.985 deg,	P = -15.000 deg,	R = -0.002 deg
};
P[167]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 2.461  mm,	Y = 0.970  mm,	Z = 0.000  mm,
	W = -179.985 deg,	P = -15.000 deg,	R = -0.002 deg
};
P[168]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 3.681  mm,	Y = 0.970  mm,	Z = 0.000  mm,
	W = -179.985 deg,	P = -15.000 deg,	R = -0.002 deg
};
P[169]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 4.901  mm,	Y = 0.970  mm,	Z = 0.000  mm,
	W = -179.985 deg,	P = -15.000 deg,	R = -0.002 deg
};
P[170]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 6.121  mm,	Y = 0.970  mm,	Z = 0.000  mm,
	W = -179.985 deg,	P = -15.000 deg,	R = -0.002 deg
};
P[171]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 7.340  mm,	Y = 0.970  mm,	Z = 0.000  mm,
	W = -179.985 deg,	P = -15.000 deg,	R = -0.002 deg
};
P[172]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 8.560  mm,	Y = 0.970  mm,	Z = 0.000  mm,
	W = -179.985 deg,	P = -15.000 deg,	R = -0.002 deg
};
P[173]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 9.780  mm,	Y = 0.970  mm,	Z = 0.000  mm,
	W = -179.985 deg,	P = -15.000 deg,	R = -0.002 deg
};
P[174]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 11.000  mm,	Y = 0.970  mm,	Z = 0.000  mm,
	W = -179.985 deg,	P = -15.000 deg,	R = -0.002 deg
};
P[175]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 11.000  mm,	Y = 0.000  mm,	Z = 0.000  mm,
	W = 180.000 deg,	P = -15.000 deg,	R = 0.000 deg
};
P[176]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 9.778  mm,	Y = 0.000  mm,	Z = 0.000  mm,
	W = 180.000 deg,	P = -15.000 deg,	R = 0.000 deg
};
P[177]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 8.556  mm,	Y = 0.000  mm,	Z = 0.000  mm,
	W = 180.000 deg,	P = -15.000 deg,	R = 0.000 deg
};
P[178]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 7.333  mm,	Y = 0.000  mm,	Z = 0.000  mm,
	W = 180.000 deg,	P = -15.000 deg,	R = 0.000 deg
};
P[179]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 6.111  mm,	Y = 0.000  mm,	Z = 0.000  mm,
	W = 180.000 deg,	P = -15.000 deg,	R = 0.000 deg
};
P[180]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 4.889  mm,	Y = 0.000  mm,	Z = 0.000  mm,
	W = 180.000 deg,	P = -15.000 deg,	R = 0.000 deg
};
P[181]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 3.667  mm,	Y = 0.000  mm,	Z = 0.000  mm,
	W = 180.000 deg,	P = -15.000 deg,	R = 0.000 deg
};
P[182]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 2.444  mm,	Y = 0.000  mm,	Z = 0.000  mm,
	W = 180.000 deg,	P = -15.000 deg,	R = 0.000 deg
};
P[183]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 1.222  mm,	Y = 0.000  mm,	Z = 0.000  mm,
	W = 180.000 deg,	P = -15.000 deg,	R = 0.000 deg
};
P[184]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 0.000  mm,	Y = 0.000  mm,	Z = 0.000  mm,
	W = 180.000 deg,	P = -15.000 deg,	R = 0.000 deg
};
P[185]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -1.222  mm,	Y = 0.000  mm,	Z = 0.000  mm,
	W = 180.000 deg,	P = -15.000 deg,	R = 0.000 deg
};
P[186]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -2.444  mm,	Y = 0.000  mm,	Z = 0.000  mm,
	W = 180.000 deg,	P = -15.000 deg,	R = 0.000 deg
};
P[187]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -3.667  mm,	Y = 0.000  mm,	Z = 0.000  mm,
	W = 180.000 deg,	P = -15.000 deg,	R = 0.000 deg
};
P[188]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -4.889  mm,	Y = 0.000  mm,	Z = 0.000  mm,
	W = 180.000 deg,	P = -15.000 deg,	R = 0.000 deg
};
P[189]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -6.111  mm,	Y = 0.000  mm,	Z = 0.000  mm,
	W = 180.000 deg,	P = -15.000 deg,	R = 0.000 deg
};
P[190]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -7.333  mm,	Y = 0.000  mm,	Z = 0.000  mm,
	W = 180.000 deg,	P = -15.000 deg,	R = 0.000 deg
};
P[191]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -8.556  mm,	Y = 0.000  mm,	Z = 0.000  mm,
	W = 180.000 deg,	P = -15.000 deg,	R = 0.000 deg
};
P[192]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -9.778  mm,	Y = 0.000  mm,	Z = 0.000  mm,
	W = 180.000 deg,	P = -15.000 deg,	R = 0.000 deg
};
P[193]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -11.000  mm,	Y = 0.000  mm,	Z = 0.000  mm,
	W = 180.000 deg,	P = -15.000 deg,	R = 0.000 deg
};
P[194]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -11.000  mm,	Y = -0.970  mm,	Z = 0.000  mm,
	W = 179.985 deg,	P = -15.000 deg,	R = 0.002 deg
};
P[195]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -9.780  mm,	Y = -0.970  mm,	Z = 0.000  mm,
	W = 179.985 deg,	P = -15.000 deg,	R = 0.002 deg
};
P[196]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -8.560  mm,	Y = -0.970  mm,	Z = 0.000  mm,
	W = 179.985 deg,	P = -15.000 deg,	R = 0.002 deg
};
P[197]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -7.340  mm,	Y = -0.970  mm,	Z = 0.000  mm,
	W = 179.985 deg,	P = -15.000 deg,	R = 0.002 deg
};
P[198]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -6.121  mm,	Y = -0.970  mm,	Z = 0.000  mm,
	W = 179.985 deg,	P = -15.000 deg,	R = 0.002 deg
};
P[199]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -4.901  mm,	Y = -0.970  mm,	Z = 0.000  mm,
	W = 179.985 deg,	P = -15.000 deg,	R = 0.002 deg
};
P[200]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -3.681  mm,	Y = -0.970  mm,	Z = 0.000  mm,
	W = 179.985 deg,	P = -15.000 deg,	R = 0.002 deg
};
P[201]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -2.461  mm,	Y = -0.970  mm,	Z = 0.000  mm,
	W = 179.985 deg,	P = -15.000 deg,	R = 0.002 deg
};
P[202]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -1.241  mm,	Y = -0.970  mm,	Z = 0.000  mm,
	W = 179.985 deg,	P = -15.000 deg,	R = 0.002 deg
};
P[203]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -0.021  mm,	Y = -0.970  mm,	Z = 0.000  mm,
	W = 179.985 deg,	P = -15.000 deg,	R = 0.002 deg
};
P[204]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 1.198  mm,	Y = -0.970  mm,	Z = 0.000  mm,
	W = 179.985 deg,	P = -15.000 deg,	R = 0.002 deg
};
P[205]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 2.418  mm,	Y = -0.970  mm,	Z = 0.000  mm,
	W = 179.985 deg,	P = -15.000 deg,	R = 0.002 deg
};
P[206]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 3.638  mm,	Y = -0.970  mm,	Z = 0.000  mm,
	W = 179.985 deg,	P = -15.000 deg,	R = 0.002 deg
};
P[207]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 4.858  mm,	Y = -0.970  mm,	Z = 0.000  mm,
	W = 179.985 deg,	P = -15.000 deg,	R = 0.002 deg
};
P[208]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 6.078  mm,	Y = -0.970  mm,	Z = 0.000  mm,
	W = 179.985 deg,	P = -15.000 deg,	R = 0.002 deg
};
P[209]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 7.298  mm,	Y = -0.970  mm,	Z = 0.000  mm,
	W = 179.985 deg,	P = -15.000 deg,	R = 0.002 deg
};
P[210]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 8.517  mm,	Y = -0.970  mm,	Z = 0.000  mm,
	W = 179.985 deg,	P = -15.000 deg,	R = 0.002 deg
};
P[211]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 9.737  mm,	Y = -0.970  mm,	Z = 0.000  mm,
	W = 179.985 deg,	P = -15.000 deg,	R = 0.002 deg
};
P[212]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 10.957  mm,	Y = -0.970  mm,	Z = 0.000  mm,
	W = 179.985 deg,	P = -15.000 deg,	R = 0.002 deg
};
P[213]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 10.957  mm,	Y = -1.940  mm,	Z = 0.000  mm,
	W = 179.971 deg,	P = -15.000 deg,	R = 0.004 deg
};
P[214]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 9.676  mm,	Y = -1.940  mm,	Z = 0.000  mm,
	W = 179.971 deg,	P = -15.000 deg,	R = 0.004 deg
};
P[215]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 8.394  mm,	Y = -1.940  mm,	Z = 0.000  mm,
	W = 179.970 deg,	P = -15.000 deg,	R = 0.004 deg
};
P[216]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 7.113  mm,	Y = -1.940  mm,	Z = 0.000  mm,
	W = 179.970 deg,	P = -15.000 deg,	R = 0.004 deg
};
P[217]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 5.831  mm,	Y = -1.940  mm,	Z = 0.000  mm,
	W = 179.970 deg,	P = -15.000 deg,	R = 0.004 deg
};
P[218]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 4.550  mm,	Y = -1.940  mm,	Z = 0.000  mm,
	W = 179.970 deg,	P = -15.000 deg,	R = 0.004 deg
};
P[219]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 3.268  mm,	Y = -1.940  mm,	Z = 0.000  mm,
	W = 179.970 deg,	P = -15.000 deg,	R = 0.004 deg
};
P[220]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 1.987  mm,	Y = -1.940  mm,	Z = 0.000  mm,
	W = 179.970 deg,	P = -15.000 deg,	R = 0.004 deg
};
P[221]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 0.706  mm,	Y = -1.940  mm,	Z = 0.000  mm,
	W = 179.970 deg,	P = -15.000 deg,	R = 0.004 deg
};
P[222]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -0.576  mm,	Y = -1.940  mm,	Z = 0.000  mm,
	W = 179.970 deg,	P = -15.000 deg,	R = 0.004 deg
};
P[223]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -1.857  mm,	Y = -1.940  mm,	Z = 0.000  mm,
	W = 179.970 deg,	P = -15.000 deg,	R = 0.004 deg
};
P[224]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -3.139  mm,	Y = -1.940  mm,	Z = 0.000  mm,
	W = 179.970 deg,	P = -15.000 deg,	R = 0.004 deg
};
P[225]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -4.420  mm,	Y = -1.940  mm,	Z = 0.000  mm,
	W = 179.970 deg,	P = -15.000 deg,	R = 0.004 deg
};
P[226]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -5.702  mm,	Y = -1.940  mm,	Z = 0.000  mm,
	W = 179.970 deg,	P = -15.000 deg,	R = 0.004 deg
};
P[227]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -6.983  mm,	Y = -1.940  mm,	Z = 0.000  mm,
	W = 179.970 deg,	P = -15.000 deg,	R = 0.004 deg
};
P[228]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -8.265  mm,	Y = -1.940  mm,	Z = 0.000  mm,
	W = 179.970 deg,	P = -15.000 deg,	R = 0.004 deg
};
P[229]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -9.546  mm,	Y = -1.940  mm,	Z = 0.000  mm,
	W = 179.970 deg,	P = -15.000 deg,	R = 0.004 deg
};
P[230]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -10.828  mm,	Y = -1.940  mm,	Z = 0.000  mm,
	W = 179.970 deg,	P = -15.000 deg,	R = 0.004 deg
};
P[231]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -10.828  mm,	Y = -2.910  mm,	Z = 0.000  mm,
	W = 179.955 deg,	P = -15.000 deg,	R = 0.006 deg
};
P[232]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -9.567  mm,	Y = -2.910  mm,	Z = 0.000  mm,
	W = 179.955 deg,	P = -15.000 deg,	R = 0.006 deg
};
P[233]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -8.306  mm,	Y = -2.910  mm,	Z = 0.000  mm,
	W = 179.955 deg,	P = -15.000 deg,	R = 0.006 deg
};
P[234]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -7.045  mm,	Y = -2.910  mm,	Z = 0.000  mm,
	W = 179.955 deg,	P = -15.000 deg,	R = 0.006 deg
};
P[235]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -5.784  mm,	Y = -2.910  mm,	Z = 0.000  mm,
	W = 179.955 deg,	P = -15.000 deg,	R = 0.006 deg
};
P[236]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -4.523  mm,	Y = -2.910  mm,	Z = 0.000  mm,
	W = 179.955 deg,	P = -15.000 deg,	R = 0.006 deg
};
P[237]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -3.262  mm,	Y = -2.910  mm,	Z = 0.000  mm,
	W = 179.955 deg,	P = -15.000 deg,	R = 0.006 deg
};
P[238]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -2.001  mm,	Y = -2.910  mm,	Z = 0.000  mm,
	W = 179.955 deg,	P = -15.000 deg,	R = 0.006 deg
};
P[239]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -0.740  mm,	Y = -2.910  mm,	Z = 0.000  mm,
	W = 179.955 deg,	P = -15.000 deg,	R = 0.006 deg
};
P[240]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 0.521  mm,	Y = -2.910  mm,	Z = 0.000  mm,
	W = 179.955 deg,	P = -15.000 deg,	R = 0.006 deg
};
P[241]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 1.782  mm,	Y = -2.910  mm,	Z = 0.000  mm,
	W = 179.955 deg,	P = -15.000 deg,	R = 0.006 deg
};
P[242]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 3.043  mm,	Y = -2.910  mm,	Z = 0.000  mm,
	W = 179.955 deg,	P = -15.000 deg,	R = 0.006 deg
};
P[243]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 4.303  mm,	Y = -2.910  mm,	Z = 0.000  mm,
	W = 179.956 deg,	P = -15.000 deg,	R = 0.006 deg
};
P[244]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 5.564  mm,	Y = -2.910  mm,	Z = 0.000  mm,
	W = 179.956 deg,	P = -15.000 deg,	R = 0.006 deg
};
P[245]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 6.825  mm,	Y = -2.910  mm,	Z = 0.000  mm,
	W = 179.956 deg,	P = -15.000 deg,	R = 0.006 deg
};
P[246]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 8.086  mm,	Y = -2.910  mm,	Z = 0.000  mm,
	W = 179.956 deg,	P = -15.000 deg,	R = 0.006 deg
};
P[247]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 9.347  mm,	Y = -2.910  mm,	Z = 0.000  mm,
	W = 179.956 deg,	P = -15.000 deg,	R = 0.006 deg
};
P[248]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 10.608  mm,	Y = -2.910  mm,	Z = 0.000  mm,
	W = 179.956 deg,	P = -15.000 deg,	R = 0.006 deg
};
P[249]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 10.608  mm,	Y = -3.880  mm,	Z = 0.000  mm,
	W = 179.941 deg,	P = -15.000 deg,	R = 0.008 deg
};
P[250]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 9.379  mm,	Y = -3.880  mm,	Z = 0.000  mm,
	W = 179.941 deg,	P = -15.000 deg,	R = 0.008 deg
};
P[251]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 8.149  mm,	Y = -3.880  mm,	Z = 0.000  mm,
	W = 179.941 deg,	P = -15.000 deg,	R = 0.008 deg
};
P[252]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 6.920  mm,	Y = -3.880  mm,	Z = 0.000  mm,
	W = 179.941 deg,	P = -15.000 deg,	R = 0.008 deg
};
P[253]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 5.690  mm,	Y = -3.880  mm,	Z = 0.000  mm,
	W = 179.941 deg,	P = -15.000 deg,	R = 0.008 deg
};
P[254]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 4.461  mm,	Y = -3.880  mm,	Z = 0.000  mm,
	W = 179.941 deg,	P = -15.000 deg,	R = 0.008 deg
};
P[255]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 3.231  mm,	Y = -3.880  mm,	Z = 0.000  mm,
	W = 179.941 deg,	P = -15.000 deg,	R = 0.008 deg
};
P[256]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 2.002  mm,	Y = -3.880  mm,	Z = 0.000  mm,
	W = 179.941 deg,	P = -15.000 deg,	R = 0.008 deg
};
P[257]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 0.772  mm,	Y = -3.880  mm,	Z = 0.000  mm,
	W = 179.940 deg,	P = -15.000 deg,	R = 0.008 deg
};
P[258]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -0.457  mm,	Y = -3.880  mm,	Z = 0.000  mm,
	W = 179.940 deg,	P = -15.000 deg,	R = 0.008 deg
};
P[259]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -1.687  mm,	Y = -3.880  mm,	Z = 0.000  mm,
	W = 179.940 deg,	P = -15.000 deg,	R = 0.008 deg
};
P[260]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -2.916  mm,	Y = -3.880  mm,	Z = 0.000  mm,
	W = 179.940 deg,	P = -15.000 deg,	R = 0.008 deg
};
P[261]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -4.146  mm,	Y = -3.880  mm,	Z = 0.000  mm,
	W = 179.940 deg,	P = -15.000 deg,	R = 0.008 deg
};
P[262]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -5.375  mm,	Y = -3.880  mm,	Z = 0.000  mm,
	W = 179.940 deg,	P = -15.000 deg,	R = 0.008 deg
};
P[263]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -6.605  mm,	Y = -3.880  mm,	Z = 0.000  mm,
	W = 179.940 deg,	P = -15.000 deg,	R = 0.008 deg
};
P[264]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -7.834  mm,	Y = -3.880  mm,	Z = 0.000  mm,
	W = 179.940 deg,	P = -15.000 deg,	R = 0.008 deg
};
P[265]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -9.064  mm,	Y = -3.880  mm,	Z = 0.000  mm,
	W = 179.940 deg,	P = -15.000 deg,	R = 0.008 deg
};
P[266]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -10.293  mm,	Y = -3.880  mm,	Z = 0.000  mm,
	W = 179.940 deg,	P = -15.000 deg,	R = 0.008 deg
};
P[267]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -10.293  mm,	Y = -4.850  mm,	Z = 0.000  mm,
	W = 179.925 deg,	P = -15.000 deg,	R = 0.010 deg
};
P[268]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -9.033  mm,	Y = -4.850  mm,	Z = 0.000  mm,
	W = 179.925 deg,	P = -15.000 deg,	R = 0.010 deg
};
P[269]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -7.772  mm,	Y = -4.850  mm,	Z = 0.000  mm,
	W = 179.925 deg,	P = -15.000 deg,	R = 0.010 deg
};
P[270]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -6.512  mm,	Y = -4.850  mm,	Z = 0.000  mm,
	W = 179.925 deg,	P = -15.000 deg,	R = 0.010 deg
};
P[271]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -5.251  mm,	Y = -4.850  mm,	Z = 0.000  mm,
	W = 179.925 deg,	P = -15.000 deg,	R = 0.010 deg
};
P[272]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -3.991  mm,	Y = -4.850  mm,	Z = 0.000  mm,
	W = 179.925 deg,	P = -15.000 deg,	R = 0.010 deg
};
P[273]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -2.731  mm,	Y = -4.850  mm,	Z = 0.000  mm,
	W = 179.925 deg,	P = -15.000 deg,	R = 0.010 deg
};
P[274]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -1.470  mm,	Y = -4.850  mm,	Z = 0.000  mm,
	W = 179.925 deg,	P = -15.000 deg,	R = 0.010 deg
};
P[275]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -0.210  mm,	Y = -4.850  mm,	Z = 0.000  mm,
	W = 179.926 deg,	P = -15.000 deg,	R = 0.010 deg
};
P[276]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 1.050  mm,	Y = -4.850  mm,	Z = 0.000  mm,
	W = 179.926 deg,	P = -15.000 deg,	R = 0.010 deg
};
P[277]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 2.311  mm,	Y = -4.850  mm,	Z = 0.000  mm,
	W = 179.926 deg,	P = -15.000 deg,	R = 0.010 deg
};
P[278]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 3.571  mm,	Y = -4.850  mm,	Z = 0.000  mm,
	W = 179.926 deg,	P = -15.000 deg,	R = 0.010 deg
};
P[279]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 4.832  mm,	Y = -4.850  mm,	Z = 0.000  mm,
	W = 179.926 deg,	P = -15.000 deg,	R = 0.010 deg
};
P[280]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 6.092  mm,	Y = -4.850  mm,	Z = 0.000  mm,
	W = 179.926 deg,	P = -15.000 deg,	R = 0.010 deg
};
P[281]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 7.352  mm,	Y = -4.850  mm,	Z = 0.000  mm,
	W = 179.926 deg,	P = -15.000 deg,	R = 0.010 deg
};
P[282]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 8.613  mm,	Y = -4.850  mm,	Z = 0.000  mm,
	W = 179.926 deg,	P = -15.000 deg,	R = 0.010 deg
};
P[283]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 9.873  mm,	Y = -4.850  mm,	Z = 0.000  mm,
	W = 179.926 deg,	P = -15.000 deg,	R = 0.010 deg
};
P[284]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 9.873  mm,	Y = -5.820  mm,	Z = 0.000  mm,
	W = 179.912 deg,	P = -15.000 deg,	R = 0.012 deg
};
P[285]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 8.593  mm,	Y = -5.820  mm,	Z = 0.000  mm,
	W = 179.911 deg,	P = -15.000 deg,	R = 0.012 deg
};
P[286]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 7.312  mm,	Y = -5.820  mm,	Z = 0.000  mm,
	W = 179.911 deg,	P = -15.000 deg,	R = 0.012 deg
};
P[287]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 6.032  mm,	Y = -5.820  mm,	Z = 0.000  mm,
	W = 179.911 deg,	P = -15.000 deg,	R = 0.012 deg
};
P[288]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 4.751  mm,	Y = -5.820  mm,	Z = 0.000  mm,
	W = 179.911 deg,	P = -15.000 deg,	R = 0.012 deg
};
P[289]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 3.471  mm,	Y = -5.820  mm,	Z = 0.000  mm,
	W = 179.911 deg,	P = -15.000 deg,	R = 0.012 deg
};
P[290]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 2.190  mm,	Y = -5.820  mm,	Z = 0.000  mm,
	W = 179.911 deg,	P = -15.000 deg,	R = 0.012 deg
};
P[291]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 0.910  mm,	Y = -5.820  mm,	Z = 0.000  mm,
	W = 179.911 deg,	P = -15.000 deg,	R = 0.012 deg
};
P[292]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -0.371  mm,	Y = -5.820  mm,	Z = 0.000  mm,
	W = 179.911 deg,	P = -15.000 deg,	R = 0.012 deg
};
P[293]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -1.651  mm,	Y = -5.820  mm,	Z = 0.000  mm,
	W = 179.911 deg,	P = -15.000 deg,	R = 0.012 deg
};
P[294]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -2.932  mm,	Y = -5.820  mm,	Z = 0.000  mm,
	W = 179.910 deg,	P = -15.000 deg,	R = 0.012 deg
};
P[295]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -4.212  mm,	Y = -5.820  mm,	Z = 0.000  mm,
	W = 179.910 deg,	P = -15.000 deg,	R = 0.012 deg
};
P[296]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -5.493  mm,	Y = -5.820  mm,	Z = 0.000  mm,
	W = 179.910 deg,	P = -15.000 deg,	R = 0.012 deg
};
P[297]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -6.773  mm,	Y = -5.820  mm,	Z = 0.000  mm,
	W = 179.910 deg,	P = -15.000 deg,	R = 0.012 deg
};
P[298]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -8.054  mm,	Y = -5.820  mm,	Z = 0.000  mm,
	W = 179.910 deg,	P = -15.000 deg,	R = 0.012 deg
};
P[299]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -9.334  mm,	Y = -5.820  mm,	Z = 0.000  mm,
	W = 179.910 deg,	P = -15.000 deg,	R = 0.012 deg
};
P[300]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -9.334  mm,	Y = -6.790  mm,	Z = 0.000  mm,
	W = 179.895 deg,	P = -15.000 deg,	R = 0.014 deg
};
P[301]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -8.049  mm,	Y = -6.790  mm,	Z = 0.000  mm,
	W = 179.895 deg,	P = -15.000 deg,	R = 0.014 deg
};
P[302]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -6.764  mm,	Y = -6.790  mm,	Z = 0.000  mm,
	W = 179.895 deg,	P = -15.000 deg,	R = 0.014 deg
};
P[303]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -5.480  mm,	Y = -6.790  mm,	Z = 0.000  mm,
	W = 179.895 deg,	P = -15.000 deg,	R = 0.014 deg
};
P[304]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -4.195  mm,	Y = -6.790  mm,	Z = 0.000  mm,
	W = 179.895 deg,	P = -15.000 deg,	R = 0.014 deg
};
P[305]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -2.910  mm,	Y = -6.790  mm,	Z = 0.000  mm,
	W = 179.895 deg,	P = -15.000 deg,	R = 0.014 deg
};
P[306]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -1.625  mm,	Y = -6.790  mm,	Z = 0.000  mm,
	W = 179.896 deg,	P = -15.000 deg,	R = 0.014 deg
};
P[307]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -0.340  mm,	Y = -6.790  mm,	Z = 0.000  mm,
	W = 179.896 deg,	P = -15.000 deg,	R = 0.014 deg
};
P[308]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 0.945  mm,	Y = -6.790  mm,	Z = 0.000  mm,
	W = 179.896 deg,	P = -15.000 deg,	R = 0.014 deg
};
P[309]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 2.230  mm,	Y = -6.790  mm,	Z = 0.000  mm,
	W = 179.896 deg,	P = -15.000 deg,	R = 0.014 deg
};
P[310]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 3.515  mm,	Y = -6.790  mm,	Z = 0.000  mm,
	W = 179.896 deg,	P = -15.000 deg,	R = 0.014 deg
};
P[311]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 4.800  mm,	Y = -6.790  mm,	Z = 0.000  mm,
	W = 179.896 deg,	P = -15.000 deg,	R = 0.014 deg
};
P[312]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 6.084  mm,	Y = -6.790  mm,	Z = 0.000  mm,
	W = 179.896 deg,	P = -15.000 deg,	R = 0.014 deg
};
P[313]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 7.369  mm,	Y = -6.790  mm,	Z = 0.000  mm,
	W = 179.897 deg,	P = -15.000 deg,	R = 0.014 deg
};
P[314]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 8.654  mm,	Y = -6.790  mm,	Z = 0.000  mm,
	W = 179.897 deg,	P = -15.000 deg,	R = 0.014 deg
};
P[315]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 8.654  mm,	Y = -7.760  mm,	Z = 0.000  mm,
	W = 179.882 deg,	P = -15.000 deg,	R = 0.016 deg
};
P[316]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 7.389  mm,	Y = -7.760  mm,	Z = 0.000  mm,
	W = 179.882 deg,	P = -15.000 deg,	R = 0.016 deg
};
P[317]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 6.123  mm,	Y = -7.760  mm,	Z = 0.000  mm,
	W = 179.882 deg,	P = -15.000 deg,	R = 0.016 deg
};
P[318]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 4.858  mm,	Y = -7.760  mm,	Z = 0.000  mm,
	W = 179.881 deg,	P = -15.000 deg,	R = 0.016 deg
};
P[319]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 3.593  mm,	Y = -7.760  mm,	Z = 0.000  mm,
	W = 179.881 deg,	P = -15.000 deg,	R = 0.016 deg
};
P[320]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 2.327  mm,	Y = -7.760  mm,	Z = 0.000  mm,
	W = 179.881 deg,	P = -15.000 deg,	R = 0.016 deg
};
P[321]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 1.062  mm,	Y = -7.760  mm,	Z = 0.000  mm,
	W = 179.881 deg,	P = -15.000 deg,	R = 0.016 deg
};
P[322]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -0.204  mm,	Y = -7.760  mm,	Z = 0.000  mm,
	W = 179.881 deg,	P = -15.000 deg,	R = 0.016 deg
};
P[323]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -1.469  mm,	Y = -7.760  mm,	Z = 0.000  mm,
	W = 179.881 deg,	P = -15.000 deg,	R = 0.016 deg
};
P[324]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -2.735  mm,	Y = -7.760  mm,	Z = 0.000  mm,
	W = 179.881 deg,	P = -15.000 deg,	R = 0.016 deg
};
P[325]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -4.000  mm,	Y = -7.760  mm,	Z = 0.000  mm,
	W = 179.880 deg,	P = -15.000 deg,	R = 0.016 deg
};
P[326]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -5.265  mm,	Y = -7.760  mm,	Z = 0.000  mm,
	W = 179.880 deg,	P = -15.000 deg,	R = 0.016 deg
};
P[327]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -6.531  mm,	Y = -7.760  mm,	Z = 0.000  mm,
	W = 179.880 deg,	P = -15.000 deg,	R = 0.016 deg
};
P[328]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -7.796  mm,	Y = -7.760  mm,	Z = 0.000  mm,
	W = 179.880 deg,	P = -15.000 deg,	R = 0.016 deg
};
P[329]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -7.796  mm,	Y = -8.730  mm,	Z = 0.000  mm,
	W = 179.865 deg,	P = -14.999 deg,	R = 0.018 deg
};
P[330]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -6.589  mm,	Y = -8.730  mm,	Z = 0.000  mm,
	W = 179.865 deg,	P = -14.999 deg,	R = 0.018 deg
};
P[331]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -5.382  mm,	Y = -8.730  mm,	Z = 0.000  mm,
	W = 179.865 deg,	P = -14.999 deg,	R = 0.018 deg
};
P[332]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -4.174  mm,	Y = -8.730  mm,	Z = 0.000  mm,
	W = 179.865 deg,	P = -14.999 deg,	R = 0.018 deg
};
P[333]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -2.967  mm,	Y = -8.730  mm,	Z = 0.000  mm,
	W = 179.866 deg,	P = -14.999 deg,	R = 0.018 deg
};
P[334]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -1.759  mm,	Y = -8.730  mm,	Z = 0.000  mm,
	W = 179.866 deg,	P = -14.999 deg,	R = 0.018 deg
};
P[335]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -0.552  mm,	Y = -8.730  mm,	Z = 0.000  mm,
	W = 179.866 deg,	P = -14.999 deg,	R = 0.018 deg
};
P[336]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 0.655  mm,	Y = -8.730  mm,	Z = 0.000  mm,
	W = 179.866 deg,	P = -14.999 deg,	R = 0.018 deg
};
P[337]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 1.863  mm,	Y = -8.730  mm,	Z = 0.000  mm,
	W = 179.866 deg,	P = -14.999 deg,	R = 0.018 deg
};
P[338]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 3.070  mm,	Y = -8.730  mm,	Z = 0.000  mm,
	W = 179.866 deg,	P = -14.999 deg,	R = 0.018 deg
};
P[339]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 4.278  mm,	Y = -8.730  mm,	Z = 0.000  mm,
	W = 179.867 deg,	P = -14.999 deg,	R = 0.018 deg
};
P[340]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 5.485  mm,	Y = -8.730  mm,	Z = 0.000  mm,
	W = 179.867 deg,	P = -14.999 deg,	R = 0.018 deg
};
P[341]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 6.692  mm,	Y = -8.730  mm,	Z = 0.000  mm,
	W = 179.867 deg,	P = -14.999 deg,	R = 0.018 deg
};
P[342]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 6.692  mm,	Y = -9.700  mm,	Z = 0.000  mm,
	W = 179.852 deg,	P = -14.999 deg,	R = 0.019 deg
};
P[343]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 5.504  mm,	Y = -9.700  mm,	Z = 0.000  mm,
	W = 179.852 deg,	P = -14.999 deg,	R = 0.019 deg
};
P[344]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 4.316  mm,	Y = -9.700  mm,	Z = 0.000  mm,
	W = 179.852 deg,	P = -14.999 deg,	R = 0.020 deg
};
P[345]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 3.128  mm,	Y = -9.700  mm,	Z = 0.000  mm,
	W = 179.852 deg,	P = -14.999 deg,	R = 0.020 deg
};
P[346]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 1.940  mm,	Y = -9.700  mm,	Z = 0.000  mm,
	W = 179.851 deg,	P = -14.999 deg,	R = 0.020 deg
};
P[347]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 0.752  mm,	Y = -9.700  mm,	Z = 0.000  mm,
	W = 179.851 deg,	P = -14.999 deg,	R = 0.020 deg
};
P[348]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -0.436  mm,	Y = -9.700  mm,	Z = 0.000  mm,
	W = 179.851 deg,	P = -14.999 deg,	R = 0.020 deg
};
P[349]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -1.624  mm,	Y = -9.700  mm,	Z = 0.000  mm,
	W = 179.851 deg,	P = -14.999 deg,	R = 0.020 deg
};
P[350]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -2.812  mm,	Y = -9.700  mm,	Z = 0.000  mm,
	W = 179.851 deg,	P = -14.999 deg,	R = 0.020 deg
};
P[351]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -4.000  mm,	Y = -9.700  mm,	Z = 0.000  mm,
	W = 179.850 deg,	P = -14.999 deg,	R = 0.020 deg
};
P[352]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -5.187  mm,	Y = -9.700  mm,	Z = 0.000  mm,
	W = 179.850 deg,	P = -14.999 deg,	R = 0.020 deg
};
P[353]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -5.187  mm,	Y = -10.670  mm,	Z = 0.000  mm,
	W = 179.835 deg,	P = -14.999 deg,	R = 0.022 deg
};
P[354]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -3.977  mm,	Y = -10.670  mm,	Z = 0.000  mm,
	W = 179.836 deg,	P = -14.999 deg,	R = 0.022 deg
};
P[355]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -2.767  mm,	Y = -10.670  mm,	Z = 0.000  mm,
	W = 179.836 deg,	P = -14.999 deg,	R = 0.022 deg
};
P[356]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -1.557  mm,	Y = -10.670  mm,	Z = 0.000  mm,
	W = 179.836 deg,	P = -14.999 deg,	R = 0.022 deg
};
P[357]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -0.347  mm,	Y = -10.670  mm,	Z = 0.000  mm,
	W = 179.836 deg,	P = -14.999 deg,	R = 0.022 deg
};
P[358]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 0.863  mm,	Y = -10.670  mm,	Z = 0.000  mm,
	W = 179.836 deg,	P = -14.999 deg,	R = 0.022 deg
};
P[359]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 2.073  mm,	Y = -10.670  mm,	Z = 0.000  mm,
	W = 179.837 deg,	P = -14.999 deg,	R = 0.022 deg
};
P[360]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 3.283  mm,	Y = -10.670  mm,	Z = 0.000  mm,
	W = 179.837 deg,	P = -14.999 deg,	R = 0.021 deg
};
P[361]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 4.493  mm,	Y = -10.670  mm,	Z = 0.000  mm,
	W = 179.837 deg,	P = -14.999 deg,	R = 0.021 deg
};
P[362]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 5.703  mm,	Y = -10.670  mm,	Z = 0.000  mm,
	W = 179.837 deg,	P = -14.999 deg,	R = 0.021 deg
};
P[363]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 6.913  mm,	Y = -10.670  mm,	Z = 0.000  mm,
	W = 179.837 deg,	P = -14.999 deg,	R = 0.021 deg
};
P[364]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 8.123  mm,	Y = -10.670  mm,	Z = 0.000  mm,
	W = 179.838 deg,	P = -14.999 deg,	R = 0.021 deg
};
P[365]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 9.333  mm,	Y = -10.670  mm,	Z = 0.000  mm,
	W = 179.838 deg,	P = -14.999 deg,	R = 0.021 deg
};
P[366]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 10.543  mm,	Y = -10.670  mm,	Z = 0.000  mm,
	W = 179.838 deg,	P = -14.999 deg,	R = 0.021 deg
};
P[367]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 10.543  mm,	Y = -10.670  mm,	Z = 20.000  mm,
	W = 179.838 deg,	P = -14.999 deg,	R = 0.021 deg
};
/END
